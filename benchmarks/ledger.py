"""What trials found, a line each, so that a stopped run goes on where it was; and result files several of them fill."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from uniforce_vtla.results_file import append_line, provenance, read_lines, write_json


class Ledger:
    """Append-only lists of findings by name, each ``NAME.jsonl`` in a folder.

    ``shows`` is called with each finding as it comes: its list's name, its number in it from 1, itself.
    """

    def __init__(self, folder: Path, shows: Callable[[str, int, dict[str, Any]], None] | None = None) -> None:
        self._folder, self._shows = folder, shows

    def add(self, name: str, finding: dict[str, Any]) -> None:
        append_line(self._folder / f"{name}.jsonl", finding)
        if self._shows is not None:
            self._shows(name, len(self.read(name)), finding)

    def read(self, name: str) -> list[dict[str, Any]]:
        return read_lines(self._folder / f"{name}.jsonl")


def update(path: Path, key: str, content: dict[str, Any]) -> Path:
    """Replace one key of a result file, and under ``made_by`` the command that made it; the others stay."""
    whole = json.loads(path.read_text()) if path.is_file() else {}
    origin = whole.get("made_by", {}) | {key: provenance()}
    return write_json(path, whole | {key: content, "made_by": origin})
