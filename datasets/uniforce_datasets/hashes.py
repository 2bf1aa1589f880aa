"""Hashes of a dataset or training view (see ``uniforce_vtla.file_hashes``), each with the episode of its file."""

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
    Entries,
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
    """Return the files that count as a dataset's or view's, relative to its folder; not a system's own."""
    parts = (".",) if (root / VIEW_MARKER).is_file() else PARTS
    walked = (
        Path(folder, name)
        for part in parts
        for folder, _, names in os.walk(root / part)
        for name in names
    )
    # rglob fails where a recorder drops a folder
    paths = [path.relative_to(root) for path in walked if path.is_file()]
    names = [str(path) for path in paths if not any(map(is_foreign, path.parts))]
    return [name for name in names if name != HASHES]


def write_hashes(root: Path, episodes: Mapping[str, int | None]) -> None:
    """Write the hashes of the files that are there now; ``episodes`` has the number of those that belong to one."""
    store_hashes(root, _with_episodes(hash_files(root, files_of(root)), episodes))


def _with_episodes(entries: Entries, episodes: Mapping[str, int | None]) -> Entries:
    numbers = {name: episodes.get(name) for name in entries}
    return {
        name: entry if numbers[name] is None else entry | {"episode": numbers[name]}
        for name, entry in sorted(entries.items())
    }


def stage_hashes(root: Path, episode: int | None = None) -> None:
    """Write into the staging folder what ``hashes.json`` will be once the staged files are moved in.

    Nothing where the dataset was begun without hashes: ``uniforce verify rehash=true`` gives it some.
    """
    known = read_hashes(root, DatasetError)
    if known is None and (root / INFO).exists():
        return
    staged = root / STAGING
    # info, statistics and tasks, in meta/ itself, are rewritten with every episode
    names = files_of(staged)
    episodes = {name: episode for name in names if Path(name).parent != INFO.parent}
    store_hashes(staged, (known or {}) | _with_episodes(hash_files(staged, names), episodes))


def check_hashes(root: Path, verify: Verify = "full") -> None:
    """Compare the files of a dataset or view with its hashes; one warning where it has none.

    A commit that a kill has cut short counts as made or not made, file by file. A file that a recorder moves in
    meanwhile is looked at again: a dataset can be checked while it is recorded.

    Args:
        root: its folder.
        verify: "full" reads every file; "quick" compares the sizes of videos only; "off" does nothing.

    Raises DatasetError: a file is missing, changed, or none of the dataset's; names its episode.
    """
    if verify == "off":
        return
    if not any((folder / HASHES).exists() for folder in (root, root / COMMIT)):
        logger.warning(
            "%s", expected(str(root / HASHES), "hashes of its files", "none", _what_to_do(root))
        )
        return
    saved, doubted = _saved(root), None
    for _ in range(LOOKS):
        wrong = _wrong(*saved, verify, doubted)
        if not wrong:
            return
        before, saved, doubted = saved, _saved(root), set(wrong)
        if saved == before:
            break
    wanted, (name, came) = saved[0], next(iter(wrong.items()))
    episode = wanted[name][0].get("episode") if name in wanted else None
    where = os.path.join(root, name) + ("" if episode is None else f", episode {episode}")
    raise DatasetError(expected(where, "the file as it was saved", came, _what_to_do(root)))


def _saved(root: Path) -> tuple[dict[str, list[Entry]], dict[str, Path]]:
    """Return by name the entries that are all right, and where each file is, also in the middle of a commit."""
    stored = [read_hashes(folder, DatasetError) or {} for folder in (root, root / COMMIT)]
    names = {name: None for entries in stored for name in entries}
    wanted = {name: [entries[name] for entries in stored if name in entries] for name in names}
    return wanted, {
        name: folder / name for folder in (root / COMMIT, root) for name in files_of(folder)
    }


def _wrong(
    wanted: Mapping[str, list[Entry]],
    found: Mapping[str, Path],
    verify: Verify,
    doubted: set[str] | None,
) -> dict[str, str]:
    """Return by name what is not as it was saved, and what it is instead; ``doubted``: only these are looked at."""
    strange = {name: "one that was never saved here" for name in found if name not in wanted}
    is_video = (lambda path: path.suffix == VIDEO) if verify == "quick" else None
    asked = {
        name: entries for name, entries in wanted.items() if doubted is None or name in doubted
    }
    return strange | dict(differences(asked, found, is_video))


def _what_to_do(root: Path) -> str:
    if (root / VIEW_MARKER).is_file():
        return "Build the view again with uniforce view."
    edited = f"uniforce verify root={root} verify=full rehash=true"
    return f"Restore it from a copy; if LeRobot's own tools changed the dataset: {edited}"
