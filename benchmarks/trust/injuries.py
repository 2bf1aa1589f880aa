"""Ways to damage a file: done to a copy, which is then loaded as a user would."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import UniForceError
from uniforce_vtla.file_hashes import HASHES

Load = Callable[[Path, str], object]  # of a folder, at a depth: "full" or "quick"


@dataclass(frozen=True)
class Damage:
    """One kind."""

    name: str  # in words
    do: Callable[[Path], object]  # injures the copy in a folder
    load: Load
    of: str  # "dataset", "view" or "checkpoint"
    said: str = ""  # what the error has to name
    # whether the copy still has its hashes; without them its content has to give it away
    hashed: bool = True
    error: type[UniForceError] = UniForceError  # which it has to be
    sound: Path = Path()  # the shipped checkpoint that is copied

    def refused(self, whole: Path, folder: Path, verify: str = "full") -> str | None:
        """Return the error's line after damaging a copy of ``whole``; None if it was accepted."""
        copy = Path(shutil.copytree(whole, folder / whole.name))
        if not self.hashed:
            (copy / HASHES).unlink()
        self.do(copy)
        try:
            self.load(copy, verify)
        except self.error as error:
            return str(error)
        return None


def cut(file: Path, share: float = 0.5) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])


def flip_bit(file: Path, at: float = 0.5) -> None:
    content = bytearray(file.read_bytes())
    content[int(at * (len(content) - 1))] ^= 1
    file.write_bytes(content)


def overwrite(file: Path, at: float, content: bytes) -> None:
    with file.open("r+b") as handle:
        handle.seek(int(file.stat().st_size * at))
        handle.write(content)


def swap(one: Path, other: Path) -> None:
    kept = one.read_bytes()
    shutil.copy(other, one)
    other.write_bytes(kept)


def edit_json(file: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def edit_text(file: Path, old: str, new: str) -> None:
    """Put another text in place of one that is there; ValueError: it is not."""
    text = file.read_text()
    if old not in text:
        raise ValueError(f"{file} holds no {old!r}")
    file.write_text(text.replace(old, new, 1))
