"""Markers that a camera misses for some frames stay where it saw them last."""

import numpy as np
from scipy.spatial import cKDTree

HOLD_FRAMES = 2  # of markers missed at random in a fifth of frames one in 125 is missed for longer
# of the markers: where more are missed the pattern has jumped or gone, and none is held
MOST = 0.45
# spacings: no marker moves farther between two frames, and none of its neighbours comes nearer
MISSED = 0.5


class MarkerHold:
    """Fills missed markers of a stream in from the last image that showed them, for a few frames.

    Args:
        spacing_px: between neighbouring markers.
        frames: for how long a marker may be missed.
    """

    def __init__(self, spacing_px: float, frames: int = HOLD_FRAMES) -> None:
        self._reach_px = MISSED * spacing_px
        self._frames = frames
        self._image = np.zeros((0, 0), np.uint8)
        self._centres_px = np.zeros((0, 2))
        self._missed_for = np.zeros(0, int)

    def missed(self, centres_px: np.ndarray, lost: int) -> np.ndarray:
        """Return which remembered markers none of (M, 2) is near, as far as they are still held.

        Of no more than ``lost`` to the reference: where all are seen a sudden press has moved them.
        """
        if lost == 0:
            return np.zeros(0, int)
        away_px = cKDTree(centres_px).query(self._centres_px)[0]
        away = away_px > self._reach_px
        if away.sum() > MOST * len(away):
            return np.zeros(0, int)
        held = np.flatnonzero(away & (self._missed_for < self._frames))
        farthest = np.argsort(-away_px[held], kind="stable")
        return held[farthest[:lost]]

    def fill(self, image: np.ndarray, centres_px: np.ndarray, lost: int) -> int:
        """Draw the missed markers into an (H, W) uint8 image of (M, 2) markers; return how many."""
        missed = self.missed(centres_px, lost)
        held = [k for k in missed if self._draw(image, self._centres_px[k])]
        seen = np.zeros(len(centres_px), int)
        self._missed_for = np.concatenate([seen, self._missed_for[held] + 1])
        self._centres_px = np.concatenate([centres_px, self._centres_px[held]])
        self._image = image.copy()
        return len(held)

    def _draw(self, image: np.ndarray, centre_px: np.ndarray) -> bool:
        """Copy the marker from the last image; False: another one is in its place."""
        low = np.maximum(np.floor(centre_px - self._reach_px), 0).astype(int)
        high = np.ceil(centre_px + self._reach_px).astype(int) + 1
        window = slice(low[1], high[1]), slice(low[0], high[0])
        last = self._image[window]
        now = image[window]
        if (last & now).any():
            return False
        now |= last
        return True
