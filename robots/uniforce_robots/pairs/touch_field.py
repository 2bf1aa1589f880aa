"""Marker motion on a fixed grid: (3, 8, 8) of motion in x and y and growth, whatever markers a sensor has.

Markers are found and matched as for the hand descriptor; each cell takes the mean of the markers around it, near ones
counting more. A lost marker leaves its neighbours in charge. Finger frame in, canonical frame out.
"""

from __future__ import annotations

import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, Finger, check_marker_image
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.descriptor import MIN_MATCHES, find_blobs, marker_pitch_px, match

GRID = 8
CHANNELS = 3
FEATURES = CHANNELS * GRID * GRID
MOTION_PX, GROWTH = 10.0, 0.2  # what counts as one: typical of a firm contact


class TouchField:
    """Fields of one finger against its free-air reference.

    Args:
        reference: (480, 640) uint8 marker image in free air, as the sensor saw it.
        finger: who wears it; the right finger's field is mirrored into the canonical frame.

    Raises:
        ContractError: no marker image, or too few markers.
    """

    def __init__(self, reference: np.ndarray, finger: Finger) -> None:
        self._mirrors = finger == "right"
        self._before = find_blobs(check_marker_image(reference, "reference"))
        if len(self._before.area_px) < MIN_MATCHES:
            came = len(self._before.area_px)
            raise ContractError(expected("reference", f"≥ {MIN_MATCHES} markers", came, "Capture it again."))
        self._reach_px = marker_pitch_px(self._before.centre_px)
        self._weight = self._nearness()  # (cells, M)

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Return (192,) float32 of one (480, 640) image: motion x, motion y, growth of each cell, row by row."""
        after = find_blobs(check_marker_image(image))
        i, j = match(self._before, after, self._reach_px)
        field = np.zeros((GRID * GRID, CHANNELS), np.float32)
        if len(i) >= MIN_MATCHES:
            field[:] = self._spread(i, self._values(i, after.centre_px[j], after.area_px[j]))
        return self._canonical(field.T.reshape(CHANNELS, GRID, GRID)).ravel()

    def _values(self, i: np.ndarray, centre_px: np.ndarray, area_px: np.ndarray) -> np.ndarray:
        """(m, 3) of the matched markers, in units of a firm contact."""
        motion = (centre_px - self._before.centre_px[i]) / MOTION_PX
        growth = np.log(area_px / self._before.area_px[i]) / GROWTH
        return np.column_stack([motion, growth])

    def _spread(self, i: np.ndarray, values: np.ndarray) -> np.ndarray:
        weight = self._weight[:, i]
        return weight @ values / np.maximum(weight.sum(axis=1, keepdims=True), 1e-6)

    def _nearness(self) -> np.ndarray:
        rows, columns = MARKER_IMAGE_SHAPE
        y, x = np.meshgrid(
            (np.arange(GRID) + 0.5) * rows / GRID, (np.arange(GRID) + 0.5) * columns / GRID, indexing="ij"
        )
        cells = np.column_stack([x.ravel(), y.ravel()])
        distance = np.linalg.norm(cells[:, None] - self._before.centre_px[None], axis=-1)
        return np.exp(-0.5 * (distance / (0.7 * self._reach_px)) ** 2) + 1e-9

    def _canonical(self, field: np.ndarray) -> np.ndarray:
        if not self._mirrors:
            return field
        flipped = field[:, :, ::-1].copy()
        flipped[0] *= -1  # motion in x
        return flipped
