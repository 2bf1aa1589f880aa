"""Fill squares and discs into binary images, exactly mirror-symmetric and without loops.

Each shape is cut into row spans; the pixels of all spans are listed and set in one go.
"""

import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE

# (319.5, 239.5)
CENTRE_PX = np.array([(MARKER_IMAGE_SHAPE[1] - 1) / 2, (MARKER_IMAGE_SHAPE[0] - 1) / 2])
# positions are rounded to 1/16 px, which floats hold exactly: mirrored input, mirrored pixels
_STEP = 16.0


def fill_discs(centre_px: np.ndarray, diameter_px: np.ndarray) -> np.ndarray:
    """Return (B, 480, 640) uint8 with discs at (B, M, 2) centres, (B, M) diameters; NaN: none."""
    offset, half = _quantise(centre_px, diameter_px)
    y, rows = _rows(offset[..., 1], half)
    dy = y - offset[..., 1, None]
    reach = np.sqrt(np.maximum(half[..., None] ** 2 - dy**2, 0))
    reach = np.where(rows & (np.abs(dy) <= half[..., None]), reach, -1)
    return _fill(y, offset[..., 0, None] - reach, offset[..., 0, None] + reach, reach >= 0)


def fill_squares(
    centre_px: np.ndarray, side_px: np.ndarray, rotation_rad: float = 0.0
) -> np.ndarray:
    """Return (B, 480, 640) uint8 with squares of (B, M) sides, all turned alike (x towards y)."""
    offset, half = _quantise(centre_px, side_px)
    cos = np.cos(rotation_rad)
    sin = np.sin(rotation_rad)
    y, rows = _rows(offset[..., 1], half * (abs(cos) + abs(sin)))
    dy = y - offset[..., 1, None]
    wide = half[..., None]
    low = (-wide - dy * sin) / cos
    high = (wide - dy * sin) / cos
    if abs(sin) > 1e-6:
        ends = np.sort(np.stack([(dy * cos - wide) / sin, (dy * cos + wide) / sin]), axis=0)
        low = np.maximum(low, ends[0])
        high = np.minimum(high, ends[1])
        inside = rows & (low <= high)
    else:
        inside = rows & (np.abs(dy) <= wide)
    x = offset[..., 0, None]
    return _fill(y, x + low, x + high, inside)


def _quantise(centre_px: np.ndarray, size_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets from the image centre (B, M, 2) and half sizes (B, M), exact in binary."""
    offset = np.round((centre_px - CENTRE_PX) * _STEP) / _STEP
    # + ½ step: never ties with a pixel centre
    half = (np.floor(size_px * 0.5 * _STEP) + 0.5) / _STEP
    lost = np.isnan(offset[..., 0])
    return np.where(lost[..., None], 0, offset), np.where(lost, -1, half)


def _rows(y_offset: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return candidate rows (B, M, K) as offsets from the centre, and which lie in the image."""
    top = np.ceil(y_offset - half - 0.5) + 0.5  # pixel rows lie at half-integers from the centre
    K = max(int(np.ceil(2 * half.max(initial=0))) + 1, 1)
    y = top[..., None] + np.arange(K)
    return y, (np.abs(y) <= CENTRE_PX[1]) & (half[..., None] > 0)


def _fill(y: np.ndarray, low: np.ndarray, high: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Set the pixels of all spans (B, M, K) to 255."""
    B = len(y)
    H, W = MARKER_IMAGE_SHAPE
    image, marker, line = np.nonzero(inside)
    start = np.maximum(np.ceil(low[image, marker, line] - 0.5) + W / 2, 0)  # first column inside
    stop = np.minimum(np.floor(high[image, marker, line] - 0.5) + W / 2 + 1, W)  # one past the last
    length = np.maximum(stop - start, 0).astype(np.int64)
    row = image * H + (y[image, marker, line] + CENTRE_PX[1]).astype(np.int64)
    before = np.cumsum(length) - length  # pixels of all earlier spans
    pixels = np.repeat(row * W + start.astype(np.int64) - before, length) + np.arange(length.sum())
    filled = np.zeros(B * H * W, dtype=np.uint8)
    filled[pixels] = 255
    return filled.reshape(B, H, W)


def overlay(reference: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) uint8: markers of the reference cyan, of the current red, of both white."""
    return np.stack([current, reference, reference], axis=-1)
