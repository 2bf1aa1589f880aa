"""What the wire saw, one JSON object per line, so that a test can assert on it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TextIO


class Journal:
    """Append-only record; ``time_s`` is CLOCK_MONOTONIC, which other processes of the machine share."""

    def __init__(self, path: Path | None) -> None:
        self._file: TextIO | None = path.open("w") if path else None

    @property
    def is_on(self) -> bool:
        """Whether anybody reads; spares the 1 kHz loop the work of describing."""
        return self._file is not None

    def write(self, what: str, **details: object) -> None:
        """Add a line."""
        if self._file is not None:
            self._file.write(json.dumps({"time_s": time.monotonic(), "what": what, **details}) + "\n")

    def flush(self) -> None:
        """Make the lines so far readable for others."""
        if self._file is not None:
            self._file.flush()


def read_journal(path: Path, begin: int = 0) -> list[dict]:
    """Return a journal's whole lines from a byte on; a killed process may have left half a one at the end."""
    text = path.read_bytes()[begin:].decode()
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
