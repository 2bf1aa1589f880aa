"""What trials found, a line each, so that a stopped run goes on where it was."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Ledger:
    """Append-only lists of findings by name.

    Args:
        folder: one ``NAME.jsonl`` each.
        shows: called with each finding as it comes: its list's name, its number in it from 1, itself.
    """

    def __init__(self, folder: Path, shows: Callable[[str, int, dict[str, Any]], None] | None = None) -> None:
        self._folder, self._shows = folder, shows
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, name: str, finding: dict[str, Any]) -> None:
        """Add one; half a line that a kill has left goes before."""
        path = self._folder / f"{name}.jsonl"
        with path.open("a") as file:
            file.truncate(len(self._whole(path).encode()))
            file.write(json.dumps(finding) + "\n")
        if self._shows is not None:
            self._shows(name, len(self.read(name)), finding)

    def read(self, name: str) -> list[dict[str, Any]]:
        """Return all of a name; half a line at the end is none."""
        return [json.loads(line) for line in self._whole(self._folder / f"{name}.jsonl").splitlines()]

    @staticmethod
    def _whole(path: Path) -> str:
        text = path.read_text() if path.exists() else ""
        return text[: text.rfind("\n") + 1]
