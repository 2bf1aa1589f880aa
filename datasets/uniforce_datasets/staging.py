"""Make each saved episode durable in one step: write it aside, then move it in.

An episode is written into ``.staging``; when complete and flushed, the folder is renamed
``.commit`` (the one atomic step) and its files are moved into the dataset, ``meta/info.json`` and
``hashes.json`` last. LeRobot's own loader can open the dataset at any instant in between, its
hashes fit at any instant, and ``recover`` finishes or forgets whatever a power loss or kill -9 left
behind. One recorder at a time holds a dataset, by a file lock that ends with its process, however
that ends.
"""

import errno
import os
import shutil
import tempfile
from pathlib import Path

from filelock import FileLock, Timeout

from uniforce_datasets.dataset_info import is_foreign
from uniforce_vtla.errors import DatasetError, expected, not_stored
from uniforce_vtla.file_hashes import HASHES
from uniforce_vtla.options import absolute

# of file systems that can't, e.g. for a folder on a network
UNSYNCED = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)
STAGING = ".staging"
COMMIT = ".commit"
ORDER = (
    "data",
    "videos",
    "raw",
    "cards",
    "meta/episodes",
    "meta/tasks.parquet",
    "meta/stats.json",
    "meta/rig.json",
    "meta/info.json",
    HASHES,
)


def claim(root: str | Path) -> Path:
    """Return the folder of a dataset, made where there is none; a refused one is left as it is.

    Raises DatasetError: no name, nothing can be written there, or it holds something else.
    """
    do = "Give root=… a folder you may write to."
    if not str(root).strip():
        raise DatasetError(expected("root", "a folder", repr(str(root)), do))
    folder = absolute(root)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            foreign = [path.name for path in folder.iterdir() if not is_foreign(path.name)]
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise not_stored(f"root={root}", "a folder to write to", error, do) from error
    is_dataset = (folder / COMMIT).exists() or (folder / "meta/info.json").exists()
    if foreign and not is_dataset:
        wanted = "an empty folder or a dataset"
        raise DatasetError(expected(str(folder), wanted, foreign[:3], "Choose another root."))
    return folder


def lock(root: Path, wait_s: float) -> FileLock:
    """Return the held lock of a dataset's folder; releasing it lets others record.

    Waits ``wait_s`` for another recorder that is about to end; raises DatasetError where it still
    holds the lock.
    """
    held = FileLock(root / ".recorder.lock")
    try:
        held.acquire(timeout=wait_s)
    except Timeout as error:
        do = "Wait, or use another root."
        raise DatasetError(
            expected(str(root), "one recorder at a time", "another one", do)
        ) from error
    # another user's file, a file system without locks
    except (OSError, NotImplementedError) as error:
        raise not_stored(
            str(held.lock_file), "a file that can be locked", error, "Use another root."
        ) from error
    return held


def recover(root: Path) -> None:
    """Finish a commit that was interrupted and drop an episode that was never finished."""
    if (root / COMMIT).exists():
        _move_in(root)
    shutil.rmtree(root / STAGING, ignore_errors=True)


def commit(root: Path) -> None:
    """Move the staged episode into the dataset at ``root``."""
    for path in [*(root / STAGING).rglob("*"), root / STAGING]:
        _sync(path)
    os.replace(root / STAGING, root / COMMIT)
    _sync(root)
    _move_in(root)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in UNSYNCED:
            raise
    finally:
        os.close(handle)


def _move_in(root: Path) -> None:
    staged = root / COMMIT
    for part in ORDER:
        for file in [staged / part, *sorted((staged / part).rglob("*"))]:
            if file.is_file():
                target = root / file.relative_to(staged)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, target)
                _sync(target.parent)
    shutil.rmtree(staged, ignore_errors=True)  # empty but for files of an operating system
