"""Hashes of the files of a dataset or view, each with the episode that its file belongs to."""

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, get_args

from uniforce_datasets.dataset_info import INFO, is_foreign
from uniforce_datasets.staging import COMMIT, STAGING
from uniforce_vtla.errors import DatasetError, expected, require_one_of
from uniforce_vtla.file_hashes import (
    HASHES,
    Entry,
    differences,
    hash_files,
    read_hashes,
    store_hashes,
)
from uniforce_vtla.keys import VIEW_MARKER

logger = logging.getLogger(__name__)
Verify = Literal["full", "quick", "off"]
# folders of a dataset; whatever else lies there isn't its
PARTS = ("data", "videos", "raw", "cards", "meta")
LOOKS = 5  # at files that a recorder moved in since the look before
VIDEO = ".mp4"  # quick compares the sizes of these only


def check_verify(verify: str) -> Verify:
    """Return ``verify`` if it names a depth of checking; raise ContractError otherwise."""
    require_one_of("verify", verify, get_args(Verify))
    return verify  # type: ignore[return-value]


def files_of(root: Path) -> list[str]:
    """Return the files that count as a dataset's or view's, relative to its folder.

    Files of an operating system don't count.
    """
    parts = (".",) if (root / VIEW_MARKER).is_file() else PARTS
    found = []
    for part in parts:
        for folder, _, names in os.walk(root / part):  # rglob fails where a recorder drops a folder
            for name in names:
                path = Path(folder, name).relative_to(root)
                is_ours = str(path) != HASHES and not any(map(is_foreign, path.parts))
                if is_ours and (root / path).is_file():
                    found.append(str(path))
    return found


def write_hashes(root: Path, episodes: Mapping[str, int]) -> None:
    """Write the hashes of all files; ``episodes`` has the number of those that belong to one."""
    entries = hash_files(root, sorted(files_of(root)))
    for name in entries.keys() & episodes.keys():
        entries[name]["episode"] = episodes[name]
    store_hashes(root, entries)


def stage_hashes(root: Path, episode: int | None = None) -> None:
    """Write into the staging folder the ``hashes.json`` that will hold once the files are moved in.

    Nothing where the dataset was begun without hashes: ``uniforce verify rehash=true`` makes them.
    """
    known = read_hashes(root, DatasetError)
    if known is None and (root / INFO).exists():
        return
    staged = root / STAGING
    entries = hash_files(staged, sorted(files_of(staged)))
    for name, entry in entries.items():
        # info, statistics and tasks, in meta/ itself, are rewritten with every episode
        if episode is not None and Path(name).parent != INFO.parent:
            entry["episode"] = episode
    store_hashes(staged, (known or {}) | entries)


def check_hashes(root: Path, verify: Verify = "full") -> None:
    """Compare the files of a dataset or view with its hashes; one warning where it has none.

    A commit that a kill has cut short counts as made or not made, file by file. A file that a
    recorder moves in meanwhile is looked at again: a dataset can be checked while it is recorded.

    Args:
        root: its folder.
        verify: "full" reads every file; "quick" compares videos by size; "off" does nothing.

    Raises DatasetError: a file is missing, changed, or none of the dataset's; names its episode.
    """
    if verify == "off":
        return
    if not ((root / HASHES).exists() or (root / COMMIT / HASHES).exists()):
        do = _what_to_do(root)
        logger.warning(expected(str(root / HASHES), "hashes of its files", "none", do))
        return
    wanted, files = _saved(root)
    to_check = set(wanted)
    for _ in range(LOOKS):
        mismatches = _mismatches(wanted, files, verify, to_check)
        if not mismatches:
            return
        to_check = set(mismatches)
        before = (wanted, files)
        wanted, files = _saved(root)
        if (wanted, files) == before:
            break
    name, found = next(iter(mismatches.items()))
    where = os.path.join(root, name)
    if name in wanted and "episode" in wanted[name][0]:
        where += f", episode {wanted[name][0]['episode']}"
    raise DatasetError(expected(where, "the file as it was saved", found, _what_to_do(root)))


def _saved(root: Path) -> tuple[dict[str, list[Entry]], dict[str, Path]]:
    """Return the entries that are right and the place of each file, by name.

    In the middle of a commit a file has two entries, and may be in either folder.
    """
    wanted: dict[str, list[Entry]] = {}
    for folder in (root, root / COMMIT):
        for name, entry in (read_hashes(folder, DatasetError) or {}).items():
            wanted.setdefault(name, []).append(entry)
    files = {}
    for folder in (root / COMMIT, root):
        for name in files_of(folder):
            files[name] = folder / name
    return wanted, files


def _is_video(path: Path) -> bool:
    return path.suffix == VIDEO


def _mismatches(
    wanted: Mapping[str, list[Entry]], files: Mapping[str, Path], verify: Verify, to_check: set[str]
) -> dict[str, str]:
    """Return how files differ from their entries, by name; of those saved, check ``to_check``."""
    mismatches = {}
    for name in files:
        if name not in wanted:
            mismatches[name] = "one that was never saved here"
    asked = {name: entries for name, entries in wanted.items() if name in to_check}
    by_size = _is_video if verify == "quick" else None
    return mismatches | dict(differences(asked, files, by_size))


def _what_to_do(root: Path) -> str:
    if (root / VIEW_MARKER).is_file():
        return "Build the view again with uniforce view."
    edited = f"uniforce verify root={root} verify=full rehash=true"
    return f"Restore it from a copy; if LeRobot's own tools changed the dataset: {edited}"
