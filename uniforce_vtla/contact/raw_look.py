"""Raw frames of a sensor's camera: marker image → colour frame with its light, lens and noise.

Only as true as testing a marker finder needs: polarity, uneven coloured light, vignetting, the
TacTip's rim ring and lamp reflections. No real frame was copied.
"""

from functools import cache
from typing import Literal

import cv2
import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.markers.raster import CENTRE_PX

PixelNoise = Literal["drawn", "sheet"]

_EDGE_BLUR_PX = 1.2  # a camera's edge spread
_PIXEL_NOISE = 2.0  # grey levels, standard deviation
_GEL_MARKER_DARKNESS = 0.72  # share of light a printed marker swallows
_GEL_SHADE = 60.0  # grey levels per unit slope of the indented surface
_LAMPS_rad = np.deg2rad([90, 210, 330])  # where red, green and blue come from
_PIN_RGB = np.array([205, 215, 235], np.float32)  # pins are whitest in blue
_SHEET_ROOM_PX = 64  # by which the noise sheet is larger than a frame, each way
_RIM_PX = (247.0, 262.0)  # bright ring just outside the 240 px (20 mm) of the dome


def gelsight_frames(
    marker_images: np.ndarray,
    indentation_mm: np.ndarray,
    cell_mm: float,
    px_per_mm: float,
    rng: np.random.Generator,
    noise: PixelNoise,
) -> np.ndarray:
    """Return (B, 480, 640, 3) uint8 RGB: dark markers on a gel under three coloured lights.

    Args:
        marker_images: (B, 480, 640) uint8.
        indentation_mm: (B, G, G) inward displacement of square cells, centred on the image.
        cell_mm: their side.
        px_per_mm: image scale.
        rng: draws the noise.
        noise: where it comes from, see ``tactip_frames``.
    """
    frames = []
    for image, depth in zip(marker_images, indentation_mm, strict=True):
        planes = _slope_shades(depth, cell_mm, px_per_mm)
        planes += _gel_light()
        planes *= 1 - _GEL_MARKER_DARKNESS * _blurred(image)
        frames.append(_exposed(planes, rng, noise))
    return np.stack(frames)


def tactip_frames(
    marker_images: np.ndarray, rng: np.random.Generator, noise: PixelNoise
) -> np.ndarray:
    """Return (B, 480, 640, 3) uint8 RGB: bright pins on a black dome inside a bright rim.

    Args:
        marker_images: (B, 480, 640) uint8.
        rng: draws the noise.
        noise: "drawn" anew for every pixel, or a "sheet" drawn once (11 ms faster).
    """
    frames = []
    for image in marker_images:
        pin = _blurred(image)
        frames.append(_exposed(_dome_light() * (1 - pin) + _pin_light() * pin, rng, noise))
    return np.stack(frames)


def _blurred(image: np.ndarray) -> np.ndarray:
    """Return an (H, W) uint8 image in [0, 1], with a camera's edges."""
    return cv2.GaussianBlur(image.astype(np.float32) / 255, (0, 0), _EDGE_BLUR_PX)


def _exposed(planes: np.ndarray, rng: np.random.Generator, noise: PixelNoise) -> np.ndarray:
    """Return the (H, W, 3) uint8 frame of planes (3, H, W) with noise; changes the planes."""
    _, H, W = planes.shape
    if noise == "drawn":
        grain = rng.standard_normal((H, W, 3), dtype=np.float32) * np.float32(_PIXEL_NOISE)
        planes += grain.transpose(2, 0, 1)
    else:
        y, x = rng.integers(_SHEET_ROOM_PX, size=2)
        planes += _noise_sheet()[:, y : y + H, x : x + W]
    return cv2.merge(list(np.clip(planes, 0, 255, out=planes).astype(np.uint8)))


def _slope_shades(depth_mm: np.ndarray, cell_mm: float, px_per_mm: float) -> np.ndarray:
    """Return (3, H, W) light on slopes, one lamp per colour."""
    smooth = cv2.GaussianBlur(depth_mm.astype(np.float32), (0, 0), 1.0 / cell_mm)
    dy, dx = np.gradient(smooth, cell_mm)
    places = _cells_of_pixels(len(depth_mm), px_per_mm * cell_mm)
    shades = np.empty((len(_LAMPS_rad), *MARKER_IMAGE_SHAPE), np.float32)
    for shade, angle in zip(shades, _LAMPS_rad, strict=True):
        toward_lamp = np.cos(angle) * dx + np.sin(angle) * dy
        on_cells = (_GEL_SHADE * toward_lamp).astype(np.float32)  # few cells, many pixels
        cv2.remap(on_cells, *places, cv2.INTER_LINEAR, dst=shade)
    return shades


@cache
def _cells_of_pixels(cells: int, px_per_cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (H, W) column and row of the grid, whose middle is the image's, under each pixel."""
    H, W = MARKER_IMAGE_SHAPE
    middle = (cells - 1) / 2
    x = (np.arange(W) - CENTRE_PX[0]) / px_per_cell + middle
    y = (np.arange(H) - CENTRE_PX[1]) / px_per_cell + middle
    column, row = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return column, row


def _planes(frame: np.ndarray) -> np.ndarray:
    """Return (3, H, W) of (H, W, 3): arithmetic on whole planes is several times as fast."""
    return np.ascontiguousarray(frame.transpose(2, 0, 1))


@cache
def _noise_sheet() -> np.ndarray:
    rows, columns = MARKER_IMAGE_SHAPE
    shape = rows + _SHEET_ROOM_PX, columns + _SHEET_ROOM_PX, 3
    return _planes(
        np.random.default_rng(0).standard_normal(shape, dtype=np.float32) * np.float32(_PIXEL_NOISE)
    )


@cache
def _radius_px() -> np.ndarray:
    rows, columns = np.indices(MARKER_IMAGE_SHAPE)
    return np.hypot(columns - CENTRE_PX[0], rows - CENTRE_PX[1]).astype(np.float32)


@cache
def _gel_light() -> np.ndarray:
    """Return (3, H, W) uneven light: each colour strongest on its own side, dark corners."""
    rows, columns = np.indices(MARKER_IMAGE_SHAPE)
    x = (columns - CENTRE_PX[0]) / CENTRE_PX[0]
    y = (rows - CENTRE_PX[1]) / CENTRE_PX[1]
    light = np.stack([150 + 35 * (x * np.cos(a) + y * np.sin(a)) for a in _LAMPS_rad], axis=-1)
    vignette = 1 - 0.4 * (_radius_px() / 400) ** 2
    return _planes((light * vignette[..., None]).astype(np.float32))


@cache
def _lamp_falloff() -> np.ndarray:
    """Return (H, W, 1): pins near the rim get less light."""
    return (1 - 0.35 * (_radius_px() / 240) ** 2).clip(0.4, 1)[..., None].astype(np.float32)


@cache
def _pin_light() -> np.ndarray:
    """Return (3, H, W) colour of a pin at each place."""
    return _planes(_PIN_RGB * _lamp_falloff())


@cache
def _dome_light() -> np.ndarray:
    """Return (3, H, W) dark dome, soft reflections of six lamps, bright rim, black beyond."""
    radius = _radius_px()
    grey = 14 + 10 * (radius / 240) ** 2
    rows, columns = np.indices(MARKER_IMAGE_SHAPE)
    for angle in np.arange(6) * np.pi / 3 + 0.3:
        x, y = CENTRE_PX + 228 * np.array([np.cos(angle), np.sin(angle)])
        grey = grey + 40 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 12.0**2))
    ring = (radius > _RIM_PX[0]) & (radius < _RIM_PX[1])
    grey = np.where(ring, 190, np.where(radius >= _RIM_PX[1], 6, grey)).astype(np.float32)
    return _planes(cv2.GaussianBlur(np.repeat(grey[..., None], 3, axis=2), (0, 0), 2.0))
