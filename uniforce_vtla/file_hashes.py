"""SHA-256 of the files of a checkpoint, dataset or view: written on saving, checked on loading."""

import hashlib
import json
import logging
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import UniForceError, expected
from uniforce_vtla.json_file import read_object, replace_json

logger = logging.getLogger(__name__)
HASHES = "hashes.json"
# of a card only the header that programs read is hashed: people may edit the text
CARD = "README.md"
HEADER = re.compile(rb"---\r?\n.*?\n---", re.DOTALL)
# bytes: verify=quick hashes a checkpoint's smaller files, and compares sizes of all
QUICK_BELOW = 16 << 20
# files that loaders of checkpoints open
LOADED = ("model.safetensors", "config.json", "adapter_*", "policy_*")

# "bytes" and "sha256" of a file; of a dataset's also the "episode" it belongs to
Entry = dict[str, Any]
Entries = dict[str, Entry]  # by name relative to the folder


def hash_files(folder: Path, names: Iterable[str]) -> Entries:
    """Return size and SHA-256 of files in ``folder``; several are read at once."""

    def entry(name: str) -> Entry:
        return {"bytes": _size(folder / name), "sha256": _digest(folder / name)}

    names = list(names)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return dict(zip(names, pool.map(entry, names), strict=True))


def write_hashes(folder: str | Path, names: Iterable[str] = ()) -> Path:
    """Write size and SHA-256 of files in ``folder`` (all, or ``names``); call it last."""
    drop_hashes(folder)
    found = [Path(folder) / name for name in names] or sorted(Path(folder).iterdir())
    files = [path.name for path in found if path.is_file() and path.name[0] != "."]
    return store_hashes(Path(folder), hash_files(Path(folder), files))


def store_hashes(folder: Path, entries: Mapping[str, Entry]) -> Path:
    """Write ``hashes.json`` in one step."""
    return replace_json(folder / HASHES, dict(entries))


def drop_hashes(folder: str | Path) -> None:
    """Remove ``hashes.json``; call it before a file of the folder changes."""
    (Path(folder) / HASHES).unlink(missing_ok=True)


def read_hashes(folder: Path, error: type[UniForceError]) -> Entries | None:
    """Return what ``hashes.json`` says; None where there is none.

    Raises error: ``hashes.json`` is damaged, or names a file outside the folder.
    """
    if not (folder / HASHES).exists():
        return None
    entries = read_object(folder / HASHES, error)
    for name, entry in entries.items():
        if not _is_entry(name, entry):
            came = f"{name[:80]!r}: {entry!r}"[:200]
            do = "Copy the whole folder again."
            raise error(
                expected(str(folder / HASHES), "file names with bytes and sha256", came, do)
            )
    return entries


def hashed_names(folder: Path, error: type[UniForceError]) -> list[str]:
    """Return the names of the files that have a hash; see ``read_hashes``."""
    return list(read_hashes(folder, error) or {})


def check_hashes(folder: Path, error: type[UniForceError], verify: str = "full") -> None:
    """Compare a checkpoint's files with their hashes; a checkpoint without any only gets a warning.

    Args:
        folder: the checkpoint.
        error: what to raise.
        verify: "full", or "quick": files of 16 MB and more by size alone, or "off".

    Raises error: a file that is missing, changed or without a hash; every one is named.
    """
    if verify == "off":
        return
    entries = read_hashes(folder, error)
    if entries is None:
        logger.warning("%s has no %s: its files are not verified", folder, HASHES)
        return
    files = {}
    for name in entries:
        if os.path.isfile(folder / name):  # False for a name that no file can have, too
            files[name] = folder / name
    wanted = {name: (entry,) for name, entry in entries.items()}
    is_large = None
    if verify == "quick":
        is_large = _is_large
    wrong = [f"{name}: {came}" for name, came in differences(wanted, files, is_large)]
    for path in sorted(folder.iterdir()):
        if _is_loaded(path.name) and path.name not in entries:
            wrong.append(f"{path.name}: without a hash")
    if wrong:
        do = "A file was changed or is another checkpoint's: copy the whole checkpoint again."
        raise error(expected(str(folder), f"the files of {HASHES}", "; ".join(wrong), do))


def _is_large(path: Path) -> bool:
    return _size(path) >= QUICK_BELOW


def loaded_hash(folder: Path, error: type[UniForceError]) -> str:
    """Return one hash of what loaders open in a folder, from ``hashes.json`` if there is one."""
    names = [file.name for file in folder.iterdir() if file.is_file() and _is_loaded(file.name)]
    files = read_hashes(folder, error) or hash_files(folder, names)
    loaded = sorted((name, entry["sha256"]) for name, entry in files.items() if _is_loaded(name))
    return hashlib.sha256(json.dumps(loaded).encode()).hexdigest()


def _is_loaded(name: str) -> bool:
    return any(fnmatch(name, pattern) for pattern in LOADED)


def differences(
    wanted: Mapping[str, Sequence[Entry]],
    files: Mapping[str, Path],
    by_size: Callable[[Path], bool] | None = None,
) -> list[tuple[str, str]]:
    """Return the name of each file that is not as it was saved, and what it is instead.

    Args:
        wanted: by name, the entries that are all right.
        files: where the files are that exist.
        by_size: whether a file's size is enough; None reads every file.
    """

    def look(name: str) -> str:
        try:
            return _difference(files.get(name), wanted[name], by_size)
        except OSError as error:
            return f"unreadable: {error}"

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = zip(wanted, pool.map(look, wanted), strict=True)
        return [(name, came) for name, came in found if came]


def _difference(
    path: Path | None, accepted: Sequence[Entry], by_size: Callable[[Path], bool] | None
) -> str:
    if path is None:
        return "none"
    sizes = [entry["bytes"] for entry in accepted]
    if (size := _size(path)) not in sizes:
        return f"{size} bytes, not {sizes[0]}"
    if by_size is not None and by_size(path):
        return ""
    digests = [entry["sha256"] for entry in accepted]
    digest = _digest(path)
    if digest in digests:
        return ""
    return f"SHA-256 {digest[:12]}…, not {digests[0][:12]}…"


def _size(path: Path) -> int:
    if path.name == CARD:
        return len(_header(path))
    return path.stat().st_size


def _digest(path: Path) -> str:
    if path.name == CARD:
        return hashlib.sha256(_header(path)).hexdigest()
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _header(card: Path) -> bytes:
    found = HEADER.match(card.read_bytes())
    return found.group() if found else b""


def _is_entry(name: str, entry: Any) -> bool:
    path = Path(name)
    inside = bool(path.parts) and name == str(path) and not path.is_absolute()
    if not inside or ".." in path.parts or "\\" in name or "\0" in name:
        return False
    if not isinstance(entry, dict) or entry.keys() - {"episode"} != {"bytes", "sha256"}:
        return False
    sizes = (entry["bytes"], entry.get("episode", 0))
    return type(entry["sha256"]) is str and all(type(size) is int for size in sizes)
