"""Make each saved episode durable in one step: write it aside, then move it in.

An episode is written into ``.staging``; when complete and flushed, the folder is renamed ``.commit`` (the one atomic
step) and its files are moved into the dataset, ``meta/info.json`` and ``hashes.json`` last.  LeRobot's own loader can
open the dataset at any instant in between, its hashes fit at any instant, and ``recover`` finishes or forgets
whatever a power loss or kill -9 left behind.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from uniforce_vtla.file_hashes import HASHES

STAGING, COMMIT = ".staging", ".commit"
ORDER = (
    *("data", "videos", "raw", "cards"),
    *("meta/episodes", "meta/tasks.parquet", "meta/stats.json", "meta/info.json", HASHES),
)


def recover(root: Path) -> None:
    """Finish a commit that was interrupted and drop an episode that was never finished."""
    if (root / COMMIT).exists():
        _move_in(root)
    shutil.rmtree(root / STAGING, ignore_errors=True)


def commit(root: Path) -> None:
    """Move the staged episode into the dataset at ``root``."""
    _flush(root / STAGING)
    os.replace(root / STAGING, root / COMMIT)
    _sync(root)
    _move_in(root)


def _flush(folder: Path) -> None:
    for path in [*folder.rglob("*"), folder]:
        _sync(path)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _move_in(root: Path) -> None:
    staged = root / COMMIT
    for part in ORDER:
        source = staged / part
        for file in [source] if source.is_file() else sorted(p for p in source.rglob("*") if p.is_file()):
            target = root / file.relative_to(staged)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(file, target)
            _sync(target.parent)
    shutil.rmtree(staged)
