"""SHA-256 of every file of a dataset or training view, in ``hashes.json`` beside them, and the check against it."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from uniforce_datasets.dataset_info import INFO
from uniforce_datasets.staging import COMMIT, HASHES, STAGING
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import VIEW_MARKER

logger = logging.getLogger(__name__)

Verify = Literal["full", "quick", "off"]
PARTS = ("data", "videos", "raw", "cards", "meta")  # folders of a dataset; whatever else lies there isn't its
VIEW_PARTS = (".",)  # a training view has no folders
VIDEO = ".mp4"  # quick compares the sizes of these only


@dataclass(frozen=True)
class FileHash:
    """What a file was when it was saved; the episode where it belongs to exactly one."""

    sha256: str
    bytes: int
    episode: int | None = None


Hashes = dict[str, FileHash]


def check_verify(verify: str) -> Verify:
    """Return ``verify`` if it names a depth of checking; raise ContractError otherwise."""
    if verify not in get_args(Verify):
        raise ContractError(expected("verify", " | ".join(get_args(Verify)), repr(verify), "Name one."))
    return verify  # type: ignore[return-value]


def _what_to_do(root: Path) -> str:
    if (root / VIEW_MARKER).is_file():
        return "Build the view again with uniforce view."
    edited = f"uniforce verify root={root} verify=full rehash=true"
    return f"Restore it from a copy; if LeRobot's own tools changed the dataset: {edited}"


def files_of(root: Path, parts: Iterable[str] = PARTS) -> list[str]:
    """Return the files that count as a dataset's, relative to its folder, hidden ones left out."""
    paths = [path.relative_to(root) for part in parts for path in (root / part).rglob("*") if path.is_file()]
    return [str(path) for path in paths if not any(word.startswith(".") for word in path.parts)]


def hash_file(file: Path, episode: int | None = None) -> FileHash:
    """Return a file's hash and size; raise DatasetError if it can't be read."""
    try:
        with file.open("rb") as handle:
            digest = hashlib.file_digest(handle, "sha256").hexdigest()
            return FileHash(digest, os.fstat(handle.fileno()).st_size, episode)
    except OSError as error:
        raise DatasetError(
            expected(str(file), "a readable file", error, "Restore it from a copy.")
        ) from error


def hash_files(root: Path, names: Iterable[str], episode_of: Callable[[str], int | None]) -> Hashes:
    """Return the hashes of files in a folder; several are read at once."""
    names = list(names)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return dict(
            zip(names, pool.map(lambda name: hash_file(root / name, episode_of(name)), names), strict=True)
        )


def read_hashes(root: Path) -> Hashes | None:
    """Return what ``hashes.json`` says, None where there is none; raise DatasetError where it is damaged."""
    file = root / HASHES
    if not file.exists():
        return None
    content = read_object(file, DatasetError)
    try:
        return {name: FileHash(**entry) for name, entry in content.items()}
    except TypeError as error:
        raise DatasetError(
            expected(str(file), "hashes by file", repr(error)[:200], _what_to_do(root))
        ) from error


def write_hashes(root: Path, hashes: Hashes) -> None:
    """Write ``hashes.json`` in one step."""
    given = {name: vars(entry).items() for name, entry in sorted(hashes.items())}
    files = {name: {key: value for key, value in entry if value is not None} for name, entry in given.items()}
    fresh = root / f".{HASHES}.new"
    try:
        fresh.write_text(json.dumps(files))
        os.replace(fresh, root / HASHES)
    finally:
        fresh.unlink(missing_ok=True)  # half a file of a full disk


def stage_hashes(root: Path, episode: int | None = None) -> None:
    """Write into the staging folder what ``hashes.json`` will be once the staged files are moved in.

    Nothing where the dataset was begun without hashes: ``uniforce verify rehash=true`` gives it some.
    """
    known = read_hashes(root)
    if known is None and (root / INFO).exists():
        return
    staged = root / STAGING
    fresh = hash_files(staged, files_of(staged), lambda name: None if _shared(name) else episode)
    write_hashes(staged, (known or {}) | fresh)


def _shared(name: str) -> bool:
    return Path(name).parent == INFO.parent  # info, statistics and tasks are rewritten with every episode


def check_hashes(root: Path, verify: Verify = "full", parts: Iterable[str] = PARTS) -> None:
    """Compare a dataset's files with its hashes; one warning where it has none.

    A commit that a kill has cut short counts as made or not made, file by file.

    Args:
        root: the dataset's folder.
        verify: "full" reads every file; "quick" compares the sizes of videos only; "off" does nothing.
        parts: folders that hold its files.

    Raises:
        DatasetError: a file is missing, changed, or none of the dataset's; names its episode.
    """
    if verify == "off":
        return
    kept, pending = read_hashes(root), read_hashes(root / COMMIT)
    if kept is None and pending is None:
        logger.warning("%s", expected(str(root / HASHES), "hashes of its files", "none", _what_to_do(root)))
        return
    wanted: dict[str, list[FileHash]] = {}
    for hashes in (kept or {}, pending or {}):
        for name, entry in hashes.items():
            wanted.setdefault(name, []).append(entry)
    found = {name: folder / name for folder in (root / COMMIT, root) for name in files_of(folder, parts)}
    for name in found.keys() - wanted.keys() - {HASHES}:
        raise _differs(root, name, None, "no such file", "one that was never saved here")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        check = partial(_check_file, root, verify)
        list(pool.map(check, wanted, wanted.values(), map(found.get, wanted)))


def _check_file(root: Path, verify: Verify, name: str, accepted: list[FileHash], file: Path | None) -> None:
    episode = accepted[0].episode
    if file is None:
        raise _differs(root, name, episode, "the file", "none")
    size = file.stat().st_size
    if size not in [entry.bytes for entry in accepted]:
        raise _differs(root, name, episode, f"{accepted[0].bytes} bytes", size)
    if verify == "quick" and file.suffix == VIDEO:
        return
    if hash_file(file).sha256 not in [entry.sha256 for entry in accepted]:
        raise _differs(root, name, episode, "the content it was saved with", "another (SHA-256 differs)")


def _differs(root: Path, name: str, episode: int | None, wanted: str, came: object) -> DatasetError:
    where = f"{root / name}" + ("" if episode is None else f", episode {episode}")
    return DatasetError(expected(where, wanted, came, _what_to_do(root)))
