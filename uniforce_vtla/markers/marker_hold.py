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

    def missed(self, centres_px: np.ndarray) -> np.ndarray:
        """Return which remembered markers none of (M, 2) is near, as far as they are still held."""
        away = cKDTree(centres_px).query(self._centres_px)[0] > self._reach_px
        held = np.flatnonzero(away & (self._missed_for < self._frames))
        if away.sum() > MOST * len(away):
            return held[:0]
        return held

    def fill(self, image: np.ndarray, centres_px: np.ndarray) -> int:
        """Draw the missed markers into an (H, W) uint8 image of (M, 2) markers; return how many."""
        held = [k for k in self.missed(centres_px) if self._draw(image, self._centres_px[k])]
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
