"""Open a recorded dataset only if it is as it was saved: hashes, files, references, marker video.

After LeRobot's own tools changed it, ``rehash`` checks its content and writes its hashes anew.
"""

from collections import defaultdict
from pathlib import Path
from typing import Any

from lerobot.datasets.lerobot_dataset import LeRobotDataset

from uniforce_datasets.content import check_content
from uniforce_datasets.dataset_info import is_foreign, parquet_files, read_info
from uniforce_datasets.hashes import Verify, check_hashes, check_verify, write_hashes
from uniforce_datasets.pooled_quantiles import write_pooled_stats
from uniforce_datasets.source import Source, read_source, read_table
from uniforce_datasets.staged_writer import LOCAL
from uniforce_datasets.staging import claim, lock, recover
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import tactile_key
from uniforce_vtla.options import absolute


def open_dataset(
    root: str | Path, repo_id: str = "local/dataset", verify: str = "quick", **options: Any
) -> LeRobotDataset:
    """Return LeRobot's own dataset after checking what it doesn't check.

    Args:
        root: folder of the dataset.
        repo_id: LeRobot's name for it; the hub is never asked.
        verify: see ``check_dataset``.
        options: passed on to ``LeRobotDataset``.

    Raises DatasetError: see ``check_dataset``.
    """
    source = check_dataset(root, verify)
    for file in source.root.rglob("*.parquet"):
        if is_foreign(file.name):
            wanted = "none, LeRobot opens it as a table"
            raise DatasetError(expected(str(file), wanted, "a system's file", "Delete it."))
    given = {"root": source.root, "revision": LOCAL, "video_backend": "pyav"} | options
    return LeRobotDataset(repo_id, **given)


def check_dataset(root: str | Path, verify: str = "quick", within: Path | None = None) -> Source:
    """Check a dataset and return its source.

    Args:
        root: its folder.
        verify: "full" compares the SHA-256 of every file and decodes every frame; "quick" compares
            sizes, and hashes of all but videos, and decodes some marker images of every episode;
            "off" looks at the metadata only.
        within: folder that its links may lead into; None is the dataset's own.

    Raises DatasetError: a file is missing, damaged, exchanged or never was saved there, a marker
    stream has no reference or is lossy, a number isn't one; names file and episode; ContractError:
    another ``verify``.
    """
    depth = check_verify(verify)
    root = absolute(root)
    read_info(root, within)  # paths first: none that leads outside is opened
    check_hashes(root, depth)
    return check_whole(root, depth, within)


def check_whole(root: Path, verify: Verify, within: Path | None = None) -> Source:
    """Check a dataset whatever its hashes say; see ``check_dataset``."""
    source = read_source(root, within)
    for finger in source.fingers:
        if tactile_key(finger, reference=True) not in source.features:
            came = f"{tactile_key(finger)} alone"
            do = "Touch is read against a free-air reference: record it again with uniforce record."
            raise DatasetError(expected("dataset", tactile_key(finger, reference=True), came, do))
    check_content(source, verify)
    return source


TABLES = ("data", "meta/episodes")
NUMBERED = ("raw", "cards")  # files named after their episode, episode_000017


def rehash(root: str | Path, verify: str = "full") -> Source:
    """Check a dataset's content, pool its statistics and hash its files; return its source.

    An interrupted save is finished before. A recorder at work there is refused.

    Raises DatasetError: content that can't be trusted (see ``check_dataset``), or a recorder at
    work; no hash is changed; ContractError: another ``verify``.
    """
    depth = check_verify(verify)
    root = claim(root)
    held = lock(root, wait_s=0.0)
    try:
        recover(root)
        read_info(root)
        source = check_whole(root, depth)
        write_pooled_stats(root)  # LeRobot's own tools average the quantiles of episodes
        write_hashes(root, _episodes(source))
    finally:
        held.release()
    return source


def _episodes(source: Source) -> dict[str, int]:
    """Return the episode of each file that belongs to one alone."""
    users: dict[Path, set[int]] = defaultdict(set)
    for episode in source.episodes:
        for span in episode.videos.values():
            users[span.file].add(episode.index)
    for part in TABLES:
        for file in parquet_files(source.root / part):
            users[file] = set(read_table(file, ["episode_index"])["episode_index"].to_pylist())
    for part in NUMBERED:
        for file in (source.root / part).rglob("episode_*"):
            if (number := file.stem.removeprefix("episode_")).isdecimal():
                users[file].add(int(number))
    episodes = {}
    for file, found in users.items():
        if len(found) == 1:
            episodes[str(file.relative_to(source.root))] = found.pop()
    return episodes
