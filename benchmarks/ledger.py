"""Findings of trials, a line each, so that a stopped run goes on; and shared result files."""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from joblib import Parallel
from tqdm import tqdm

from uniforce_vtla.results_file import append_line, only_writer, provenance, read_lines, write_json


class Ledger:
    """Append-only lists of findings by name, each ``NAME.jsonl`` in a folder.

    ``shows`` is called with each finding as it comes: its list's name, its number in it from 1,
    itself.
    """

    def __init__(
        self, folder: Path, shows: Callable[[str, int, dict[str, Any]], None] | None = None
    ) -> None:
        self._folder, self._shows = folder, shows

    def add(self, name: str, finding: dict[str, Any]) -> None:
        append_line(self._folder / f"{name}.jsonl", finding)
        if self._shows is not None:
            self._shows(name, len(self.read(name)), finding)

    def read(self, name: str) -> list[dict[str, Any]]:
        return read_lines(self._folder / f"{name}.jsonl")


def played(
    path: Path, episodes: Iterable[tuple[str, int, Any]], workers: int
) -> list[dict[str, Any]]:
    """Return the rows of the ledger ``path`` once it holds these episodes.

    An episode is its cell, its scene, and joblib's call for its Row. What the ledger holds is not
    played again. Raises ContractError: another process adds to it now.
    """
    ledger = Ledger(path.parent)
    with only_writer(path):
        done = {(row["cell"], row["seed"]) for row in ledger.read(path.stem)}
        jobs = [job for cell, seed, job in episodes if (cell, seed) not in done]
        for row in tqdm(
            Parallel(workers, return_as="generator")(jobs),
            total=len(jobs),
            desc="episodes",
            disable=None,
        ):
            ledger.add(path.stem, asdict(row))
    return ledger.read(path.stem)


def update(path: Path, key: str, content: dict[str, Any]) -> Path:
    """Replace one key of a result file, and the command under ``made_by``; the others stay."""
    whole = json.loads(path.read_text()) if path.is_file() else {}
    origin = whole.get("made_by", {}) | {key: provenance()}
    return write_json(path, whole | {key: content, "made_by": origin})
