"""SHA-256 of every file of a checkpoint: written beside them when it is saved, compared when it is loaded."""

from __future__ import annotations

import hashlib
import io
import logging
import re
from collections.abc import Iterable
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import UniForceError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.results_file import write_json

logger = logging.getLogger(__name__)

HASHES = "hashes.json"
CARD = "README.md"  # of a card only the header that programs read is hashed: people may edit the text
HEADER = re.compile(rb"---\r?\n.*?\n---", re.DOTALL)
QUICK_BELOW = 16 << 20  # bytes: verify=quick hashes smaller files, and compares sizes of all
LOADED = ("model.safetensors", "config.json", "adapter_*", "policy_*")  # what loaders open


def write_hashes(folder: str | Path, names: Iterable[str] = ()) -> Path:
    """Write size and SHA-256 of files in ``folder`` (all, or ``names``) into its ``hashes.json``; call it last."""
    drop_hashes(folder)
    found = [Path(folder) / name for name in names] or sorted(Path(folder).iterdir())
    files = [path for path in found if path.is_file() and path.name[0] != "."]
    entries = {path.name: {"bytes": _size(path), "sha256": _digest(path)} for path in files}
    written = write_json(Path(folder) / HASHES, entries)
    written.chmod(0o644)
    return written


def drop_hashes(folder: str | Path) -> None:
    """Remove ``hashes.json``; call it before a file of the folder changes."""
    (Path(folder) / HASHES).unlink(missing_ok=True)


def hashed_names(folder: Path, error: type[UniForceError]) -> list[str]:
    """Return the names of the files that have a hash; none without ``hashes.json``.

    Raises:
        error: ``hashes.json`` is damaged, or names a file outside the folder.
    """
    return list(_entries(folder, error)) if (folder / HASHES).is_file() else []


def check_hashes(folder: Path, error: type[UniForceError], verify: str = "full") -> None:
    """Compare a checkpoint's files with their hashes; a checkpoint without any only gets a warning.

    Args:
        folder: the checkpoint.
        error: what to raise.
        verify: "full", or "quick": files of 16 MB and more by size alone, or "off".

    Raises:
        error: a file that is missing, changed or without a hash; every one is named.
    """
    if verify == "off":
        return
    if not (folder / HASHES).is_file():
        logger.warning("%s has no %s: its files are not verified", folder, HASHES)
        return
    entries = _entries(folder, error)
    wrong = [_difference(folder / name, entry, verify) for name, entry in entries.items()]
    wrong += [f"{path.name} without a hash" for path in _loaded(folder) if path.name not in entries]
    if any(wrong):
        do = "A file was changed or is another checkpoint's: copy the whole checkpoint again."
        raise error(expected(str(folder), f"the files of {HASHES}", "; ".join(filter(None, wrong)), do))


def _loaded(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.iterdir()) if any(fnmatch(path.name, name) for name in LOADED)]


def _difference(path: Path, entry: dict[str, Any], verify: str) -> str:
    """Return what is wrong with a file; nothing if it is as it was."""
    if not path.is_file():
        return f"no {path.name}"
    if (size := _size(path)) != entry["bytes"]:
        return f"{path.name} of {size} bytes, not {entry['bytes']}"
    if verify == "quick" and size >= QUICK_BELOW:
        return ""
    digest = _digest(path)
    return "" if digest == entry["sha256"] else f"{path.name} {digest[:12]}…, not {entry['sha256'][:12]}…"


def _size(path: Path) -> int:
    return len(_header(path)) if path.name == CARD else path.stat().st_size


def _digest(path: Path) -> str:
    with io.BytesIO(_header(path)) if path.name == CARD else path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _header(card: Path) -> bytes:
    found = HEADER.match(card.read_bytes())
    return found.group() if found else b""


def _entries(folder: Path, error: type[UniForceError]) -> dict[str, dict[str, Any]]:
    entries = read_object(folder / HASHES, error)
    for name, entry in entries.items():
        if not _is_entry(name, entry):
            came, do = f"{name[:80]!r}: {entry!r}"[:200], "Copy the whole checkpoint again."
            raise error(expected(str(folder / HASHES), "file names with bytes and sha256", came, do))
    return entries


def _is_entry(name: str, entry: Any) -> bool:
    plain = name == Path(name).name and "\\" not in name and "\0" not in name
    known = isinstance(entry, dict) and entry.keys() == {"bytes", "sha256"}
    return plain and known and type(entry["bytes"]) is int and isinstance(entry["sha256"], str)
