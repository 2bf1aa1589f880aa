"""One scale for every camera: a lens's px/mm, known from the data sheet, is taken out of its marker images.

A wider lens shrinks every motion, and a picture alone doesn't tell a near small gel from a far large one: a tokenizer
misreads the newtons behind a lens it never saw (docs/experiments/tokenizer.md). The scale of a camera on its
pad is known without any recording, so marker images of flat gels and of domes come at the scale of the GelSight and
the TacTip that pretraining is centred on. Taxels are rendered, not seen, and keep their own.
"""

import cv2
import numpy as np

from uniforce_vtla.sensors import SensorSpec, get_sensor

FLAT, DOME = get_sensor("gelsight").px_per_mm, get_sensor("tactip").px_per_mm  # the others are brought to
SAME = 1e-3  # zooms closer to 1 than this leave the image untouched


def nominal_zoom(spec: SensorSpec) -> tuple[float, float]:
    """Return the (x, y) factors that bring a sensor's marker images to nominal scale; (1, 1) for taxels."""
    if spec.signal == "taxel":
        return 1.0, 1.0
    nominal = FLAT if spec.dome_radius_mm is None else DOME
    return nominal[0] / spec.px_per_mm[0], nominal[1] / spec.px_per_mm[1]


def is_nominal(spec: SensorSpec) -> bool:
    """Return whether the sensor's images are at nominal scale as they are."""
    return all(abs(factor - 1) < SAME for factor in nominal_zoom(spec))


def to_nominal_scale(images: np.ndarray, spec: SensorSpec) -> np.ndarray:
    """Return (..., H, W) uint8 marker images in {0, 255} at nominal scale, zoomed about their centre.

    What leaves the frame is cut, what enters is black; the images come back as they are where nothing changes.
    """
    if is_nominal(spec):
        return images
    zoom, size = np.array(nominal_zoom(spec)), images.shape[:-3:-1]
    matrix = np.column_stack([np.diag(zoom), (1 - zoom) * (np.array(size) - 1) / 2])
    flat = images.reshape(-1, *images.shape[-2:])
    smooth = np.stack([cv2.warpAffine(image, matrix, size, flags=cv2.INTER_LINEAR) for image in flat])
    return sharp(smooth).reshape(images.shape)


def sharp(smooth: np.ndarray) -> np.ndarray:
    """Return uint8 images in {0, 255} of interpolated ones: an edge stays an edge."""
    return np.where(smooth >= 128, 255, 0).astype(np.uint8)


def points_to_nominal_scale(points_px: np.ndarray, spec: SensorSpec, size_px: tuple[int, int]) -> np.ndarray:
    """Return (M, 2) image points, x right and y down, where ``to_nominal_scale`` puts them; size is (H, W)."""
    centre = (np.array(size_px[::-1]) - 1) / 2
    return ((points_px - centre) * np.array(nominal_zoom(spec)) + centre).astype(points_px.dtype)
