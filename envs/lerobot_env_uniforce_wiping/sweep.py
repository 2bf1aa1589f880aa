"""The serpentine: even rows run along +y, odd rows back; x alone tells the direction."""

from __future__ import annotations

import numpy as np

from lerobot_env_uniforce_wiping.levels import Level


class Sweep:
    """A polyline over the nominal board, by arc length.

    A memoryless policy can follow it: the row's x decides the direction, the end of a row leads to the next
    row's x, and the last end is left upwards.
    """

    def __init__(self, level: Level) -> None:
        cx, cy = level.layout.board_center_m
        rows = cx + (np.arange(level.rows) - (level.rows - 1) / 2) * level.row_pitch_m
        ends = (cy - level.stroke_m / 2, cy + level.stroke_m / 2)
        corners = []
        for k, x in enumerate(rows):
            start, stop = ends if k % 2 == 0 else ends[::-1]
            corners += [(x, start), (x, stop)]
        self.corners = np.array(corners)
        self._at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.corners, axis=0), axis=1))])

    @property
    def length_m(self) -> float:
        """Total arc length."""
        return float(self._at[-1])

    def row_at(self, x_m: float) -> float:
        """Return the arc length at which the row nearest to an x begins."""
        rows = self.corners[::2, 0]
        return float(self._at[2 * int(np.argmin(np.abs(rows - x_m)))])

    def between_rows(self, along_m: float) -> bool:
        """Whether the tool moves from one row to the next there, along the closing axis."""
        return bool(np.searchsorted(self._at, along_m, side="right") % 2 == 0) and along_m < self.length_m

    def point(self, along_m: float) -> np.ndarray:
        """Return (2,) x, y at an arc length, clamped to the ends."""
        return np.array([np.interp(along_m, self._at, self.corners[:, i]) for i in range(2)])
