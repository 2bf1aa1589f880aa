"""Room on the disk: an estimate before each episode, and a stop at the next tick where it runs out."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import DiskFullError, expected

MB = 1e6
MARGIN = 1.5  # over the estimate; scenes differ
# Bytes per pixel before anything was recorded, from measured files: lossy scene, lossless markers, raw tactile.
SCENE_B_px, MARKER_B_px, RAW_B_px = 0.05, 0.02, 0.25
COLUMN_B = 8.0  # per number of a column


def free_bytes(path: Path) -> int:
    """Return the free space where ``path`` is."""
    return shutil.disk_usage(path).free


class DiskGuard:
    """Watch the disk a dataset is on.

    Args:
        root: the dataset's folder; it exists.
        features: LeRobot's, for the first estimate.
        raw_pixels: of all raw tactile frames of a tick.
        reserve_MB: what has to stay free, so that a stopped episode can still be stored.
        free: tells the free bytes; tests put their own.
    """

    def __init__(
        self,
        root: Path,
        features: Mapping[str, dict[str, Any]],
        raw_pixels: int = 0,
        reserve_MB: float = 500.0,
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        self._root, self._free = root, free
        self._reserve = reserve_MB * MB
        self._guess = sum(_frame_bytes(key, f) for key, f in features.items()) + raw_pixels * RAW_B_px

    def estimate_MB(  # noqa: N802  a unit
        self, frames: int, recorded_frames: int
    ) -> float:
        """Return what an episode of ``frames`` will take.

        Args:
            frames: at most.
            recorded_frames: already in the dataset; with some, their own size is the measure.
        """
        per_frame = self._guess
        if recorded_frames:
            per_frame = sum(f.stat().st_size for f in self._root.rglob("*") if f.is_file()) / recorded_frames
        return per_frame * frames / MB

    def before_episode(self, frames: int, recorded_frames: int) -> str:
        """Return the estimate in words.

        Raises:
            DiskFullError: an episode of ``frames`` wouldn't fit.
        """
        need_MB = self.estimate_MB(frames, recorded_frames)
        free_MB = self._free(self._root) / MB
        if free_MB < need_MB * MARGIN + self._reserve / MB:
            whole_MB = need_MB * MARGIN + self._reserve / MB
            wanted = f"{whole_MB:.0f} MB free (episode {need_MB:.0f} MB × {MARGIN} + reserve)"
            raise DiskFullError(expected(str(self._root), wanted, f"{free_MB:.0f} MB", "Free some space."))
        return f"{need_MB:.0f} MB, {free_MB / 1000:.1f} GB free"

    def check(self) -> None:
        """Raise DiskFullError once less than the reserve is left; a few microseconds."""
        free = self._free(self._root)
        if free < self._reserve:
            wanted = f"{self._reserve / MB:.0f} MB free"
            raise DiskFullError(expected(str(self._root), wanted, f"{free / MB:.0f} MB", "Free some space."))


def _frame_bytes(key: str, feature: Mapping[str, Any]) -> float:
    size = 1.0
    for length in feature["shape"]:
        size *= length
    if feature["dtype"] != "video":
        return size * COLUMN_B
    return size / 3 * (MARKER_B_px if "tactile" in key else SCENE_B_px)
