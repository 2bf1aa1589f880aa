"""Room on the disk: an estimate before each episode, and a stop where it runs out."""

import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uniforce_vtla.errors import DatasetError, DiskFullError, expected

MB = 1e6
MARGIN = 1.5  # over the estimate; scenes differ
# bytes per pixel before anything was recorded, from measured files
SCENE_B_px = 0.05  # lossy
MARKER_B_px = 0.02  # lossless
RAW_B_px = 0.25  # raw tactile
COLUMN_B = 8.0  # per number of a column


def free_bytes(path: Path) -> int:
    """Return the free space where ``path`` is."""
    return shutil.disk_usage(path).free


class DiskGuard:
    """Watch the disk a dataset is on; its folder exists.

    ``features`` (LeRobot's) and the ``raw_pixels`` of a tick give the first estimate.
    ``reserve_MB`` stays free, so that a stopped episode can be stored.
    """

    def __init__(
        self, root: Path, features: Mapping[str, dict], raw_pixels: int, reserve_MB: float
    ) -> None:
        self._root = root
        self._reserve_MB = reserve_MB
        self._guess_B = (
            sum(_frame_bytes(key, f) for key, f in features.items()) + raw_pixels * RAW_B_px
        )

    def estimate_MB(self, frames: int, recorded_frames: int) -> float:  # noqa: N802  a unit
        """Return the MB that ``frames`` will take, by the size of the recorded ones, if any."""
        if not recorded_frames:
            return self._guess_B * frames / MB
        recorded_B = sum(file.stat().st_size for file in self._root.rglob("*") if file.is_file())
        return recorded_B / recorded_frames * frames / MB

    def before_episode(self, frames: int, recorded_frames: int) -> str:
        """Return the estimate in words.

        Raises DiskFullError: an episode of ``frames`` won't fit; DatasetError: the disk has gone.
        """
        try:
            need_MB = self.estimate_MB(frames, recorded_frames)
        except OSError as error:
            raise self._gone(error) from error
        free_MB = self.check(need_MB * MARGIN, f" (episode {need_MB:.0f} MB × {MARGIN} + reserve)")
        return f"{need_MB:.0f} MB, {free_MB / 1000:.1f} GB free"

    def check(self, beside_MB: float = 0.0, why: str = "") -> float:
        """Return the free MB; takes a few microseconds.

        Raises DiskFullError: less than the reserve is left; DatasetError: the disk has gone.
        """
        try:
            free_MB = free_bytes(self._root) / MB
            wanted_MB = beside_MB + self._reserve_MB
        except OSError as error:
            raise self._gone(error) from error
        if free_MB < wanted_MB:
            wanted = f"{wanted_MB:.0f} MB free{why}"
            raise DiskFullError(
                expected(str(self._root), wanted, f"{free_MB:.0f} MB", "Free some space.")
            )
        return free_MB

    def _gone(self, error: OSError) -> DatasetError:
        return DatasetError(expected(str(self._root), "a disk", error, "Was it unplugged?"))


def _frame_bytes(key: str, feature: Mapping[str, Any]) -> float:
    size = math.prod(feature["shape"])
    if feature["dtype"] != "video":
        return size * COLUMN_B
    return size / 3 * (MARKER_B_px if "tactile" in key else SCENE_B_px)
