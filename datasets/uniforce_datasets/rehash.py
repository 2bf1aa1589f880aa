"""Write a dataset's hashes anew once its content is checked: after LeRobot's own tools changed it."""

from collections import defaultdict
from pathlib import Path

from uniforce_datasets.dataset_info import read_info
from uniforce_datasets.hashes import check_verify, write_hashes
from uniforce_datasets.lossless import check_whole
from uniforce_datasets.source import Source, read_table
from uniforce_datasets.staging import claim, lock, recover

TABLES = ("data", "meta/episodes")
NUMBERED = ("raw", "cards")  # files named after their episode
STEM = "episode_"


def rehash(root: str | Path, verify: str = "full") -> Source:
    """Check a dataset's content and write the hashes of the files that are there now; return its source.

    An interrupted save is finished before. A recorder at work there is refused.

    Raises:
        DatasetError: content that can't be trusted (see ``check_dataset``), or a recorder at work; no hash is changed.
        ContractError: another ``verify``.
    """
    root, depth = Path(root), check_verify(verify)
    held = lock(claim(root), wait_s=0.0)
    try:
        recover(root)
        read_info(root)
        source = check_whole(root, depth)
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
    for file in (file for part in TABLES for file in (source.root / part).rglob("*.parquet")):
        users[file] = set(read_table(file, ["episode_index"])["episode_index"].to_pylist())
    for file in (file for part in NUMBERED for file in (source.root / part).rglob(f"{STEM}*")):
        users[file] = {int(word) for word in [file.stem.removeprefix(STEM)] if word.isdecimal()}
    return {str(file.relative_to(source.root)): max(found) for file, found in users.items() if len(found) == 1}
