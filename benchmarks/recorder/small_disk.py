"""A disk that can be filled up: a small tmpfs where mounting is allowed, else the guard's limit raised."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from pathlib import Path

MB = 1_000_000
PAGE_B = 4096
ROOM_MB = 300  # where it can't be mounted: between what is free now and the guard's limit


class SmallDisk:
    """A folder on a small disk.

    Args:
        root: the folder.
        size_MB: of the disk.

    Attributes:
        is_own: whether it could be mounted; only then can it really be filled up.
    """

    def __init__(self, root: Path, size_MB: int) -> None:
        self._root = root
        self._ballast: list[Path] = []
        root.mkdir(parents=True, exist_ok=True)
        if root.is_mount():  # of a trial that was cut short
            subprocess.run(["umount", str(root)], check=True)
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size_MB}m", "uniforce-trial", str(root)]
        self.is_own = shutil.which("mount") is not None and not subprocess.run(mount, capture_output=True).returncode

    @property
    def kind(self) -> str:
        """Which of the two, for the result."""
        return "tmpfs of its own" if self.is_own else "guard's limit raised to the free space"

    def reserve_MB(self, wanted_MB: float) -> float:  # noqa: N802  units
        """Return the guard's limit."""
        return wanted_MB if self.is_own else shutil.disk_usage(self._root).free / MB - ROOM_MB

    def fill(self, left_MB: float, reserve_MB: float) -> None:
        """Take the room away: all but ``left_MB`` of an own disk, else enough to get below the limit."""
        free = shutil.disk_usage(self._root).free
        size = free - int(left_MB * MB) if self.is_own else int((ROOM_MB + reserve_MB) * MB)
        path = self._root.parent / f".{self._root.name}-ballast" if not self.is_own else self._root / ".ballast"
        self._ballast.append(path)
        with path.open("wb") as file:
            _take(file.fileno(), size)

    def __enter__(self) -> SmallDisk:
        return self

    def __exit__(self, *_: object) -> None:
        for path in self._ballast:
            path.unlink(missing_ok=True)
        if self.is_own:
            subprocess.run(["umount", str(self._root)], check=True)


def _take(file: int, size: int) -> None:
    """Allocate bytes, or as many as there are: a recorder takes some meanwhile."""
    taken, step = 0, size
    while taken < size and step >= PAGE_B:
        try:
            os.posix_fallocate(file, taken, min(step, size - taken))
            taken += step
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            step //= 2
