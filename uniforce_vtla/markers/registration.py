"""One scale and one place for every camera: remove its lens, then its mounting.

*Scale.* A wider lens shrinks every motion, and a picture alone doesn't tell a near small gel from a
far large one: a tokenizer misreads newtons behind an unseen lens (docs/experiments/tokenizer.md).
A camera's px/mm is on its data sheet, so flat gels and domes come at the scale of the GelSight and
the TacTip. Taxels are rendered and keep their own.

*Place.* Units of one type differ by moulding and mounting: shifted by 1 mm, turned by 5°, 6 %
nearer, 3° off square. Ten simulated TacTips read the same press with 14 % of scatter, and with the
pattern in its place with 7 %. The place is found by matching the reference's markers to the
drawing's. Another pattern than the drawing's is left where it is.
"""

import logging

import cv2
import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.markers.marker_blobs import spacing
from uniforce_vtla.markers.raster import CENTRE_PX
from uniforce_vtla.sensors import SensorSpec, get_sensor

# flat gels and domes are brought to these scales
FLAT = get_sensor("gelsight").px_per_mm
DOME = get_sensor("tactip").px_per_mm
SAME = 1e-3  # zooms closer to 1 than this leave the image untouched


def nominal_zoom(spec: SensorSpec) -> tuple[float, float]:
    """Return the (x, y) factors that bring marker images to nominal scale; 1 without camera."""
    if spec.signal != "camera":
        return 1.0, 1.0
    nominal = FLAT if spec.dome_radius_mm is None else DOME
    return nominal[0] / spec.px_per_mm[0], nominal[1] / spec.px_per_mm[1]


def is_nominal(spec: SensorSpec) -> bool:
    """Return whether the sensor's images are at nominal scale as they are."""
    return all(abs(factor - 1) < SAME for factor in nominal_zoom(spec))


def to_nominal_scale(images: np.ndarray, spec: SensorSpec) -> np.ndarray:
    """Return (..., H, W) uint8 marker images in {0, 255} at nominal scale.

    They are zoomed about the centre: overflow is cut, gaps are black.
    """
    if is_nominal(spec):
        return images
    zoom = np.array(nominal_zoom(spec))
    size = images.shape[:-3:-1]  # (W, H)
    matrix = np.column_stack([np.diag(zoom), (1 - zoom) * (np.array(size) - 1) / 2])
    smooth = np.empty_like(images)
    for place in np.ndindex(images.shape[:-2]):
        smooth[place] = cv2.warpAffine(images[place], matrix, size, flags=cv2.INTER_LINEAR)
    return sharp(smooth)


def sharp(smooth: np.ndarray) -> np.ndarray:
    """Return uint8 images in {0, 255} of interpolated ones: an edge stays an edge."""
    return (smooth >= 128) * np.uint8(255)


def points_to_nominal_scale(
    points_px: np.ndarray, spec: SensorSpec, size_px: tuple[int, int]
) -> np.ndarray:
    """Return (M, 2) image points, x right, y down, at nominal scale; size is (H, W)."""
    centre = (np.array(size_px[::-1]) - 1) / 2
    return ((points_px - centre) * np.array(nominal_zoom(spec)) + centre).astype(points_px.dtype)


logger = logging.getLogger(__name__)
TURNS_rad = np.arange(-3, 4) * 0.06  # starts of the search: ±.18
# a camera turned further was mounted so (`rotation_deg`): its pattern stands at an angle and stays
MOST_TURN_rad = 0.20
ZOOMS = (0.92, 1.0, 1.09)
ROUNDS = 15
COUNT_RATIO = 1.1  # markers seen over drawn, either way
MATCHED_SHARE = 0.9  # of the markers seen; fewer: not the drawing's pattern
REACH = 0.25  # spacings: a marker's distance from its place in the drawing


def drawn_px(spec: SensorSpec) -> np.ndarray:
    """Return (M, 2) px, x right, y down: the drawing's markers at nominal scale, in free air."""
    rim_mm = max(spec.pad_size_mm) / 2
    squeeze = 1 - spec.fisheye * (spec.layout_mm**2).sum(axis=1, keepdims=True) / rim_mm**2
    seen_px = spec.layout_mm * squeeze * np.array(spec.px_per_mm)
    return CENTRE_PX + seen_px * np.array(nominal_zoom(spec))


def find_view(centres_px: np.ndarray, spec: SensorSpec) -> np.ndarray | None:
    """Return the (3, 3) homography that brings free-air markers (K, 2) px to the drawing's places.

    None for another pattern: a different number, too few near a drawn place, or turned too far.
    """
    drawn = drawn_px(spec)
    if not 1 / COUNT_RATIO <= len(centres_px) / len(drawn) <= COUNT_RATIO:
        return None
    tree = cKDTree(drawn)
    reach = REACH * spacing(drawn)
    tried = []
    for turn_rad in TURNS_rad:
        for zoom in ZOOMS:
            start = _start(centres_px, drawn, turn_rad, zoom)
            tried.append(_refine(centres_px, drawn, tree, start))
    found = max(tried, key=lambda matrix: _close(matrix, centres_px, tree, reach))
    near, distance = _match(centres_px, tree, found)
    kept = distance < reach
    turned = abs(np.arctan2(found[1, 0], found[0, 0])) > MOST_TURN_rad
    if turned or kept.sum() < MATCHED_SHARE * len(centres_px):
        logger.info(
            "%s: the reference doesn't show the drawing's pattern; "
            "the camera's view stays as it is",
            spec.name,
        )
        return None
    view, _ = cv2.findHomography(
        centres_px[kept].astype(np.float64), drawn[near[kept]].astype(np.float64)
    )
    return view


def seen_from(image: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8 marker image in {0, 255} moved by the homography; gaps are black."""
    return sharp(cv2.warpPerspective(image, view, image.shape[::-1], flags=cv2.INTER_LINEAR))


def _start(points: np.ndarray, drawn: np.ndarray, turn_rad: float, zoom: float) -> np.ndarray:
    """Return the (2, 3) similarity that lays the points' middle on the drawing's."""
    cos = zoom * np.cos(turn_rad)
    sin = zoom * np.sin(turn_rad)
    linear = np.array([[cos, -sin], [sin, cos]])
    return np.column_stack([linear, drawn.mean(axis=0) - linear @ points.mean(axis=0)])


def _refine(points: np.ndarray, drawn: np.ndarray, tree: cKDTree, matrix: np.ndarray) -> np.ndarray:
    """Return the similarity after rounds of matching to the nearest place and fitting again."""
    for _ in range(ROUNDS):
        near, distance = _match(points, tree, matrix)
        kept = distance <= max(float(np.median(distance)) * 2, 1.0)
        again, _ = cv2.estimateAffinePartial2D(
            points[kept].astype(np.float64), drawn[near[kept]].astype(np.float64)
        )
        if again is None or np.allclose(again, matrix, atol=1e-6):
            break
        matrix = again
    return matrix


def _match(points: np.ndarray, tree: cKDTree, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest place of each point and how far it is, px."""
    distance, near = tree.query(points @ matrix[:, :2].T + matrix[:, 2])
    return near, distance


def _close(matrix: np.ndarray, points: np.ndarray, tree: cKDTree, reach_px: float) -> float:
    near, distance = _match(points, tree, matrix)
    return len(set(near[distance < reach_px])) - float(distance.mean()) / reach_px
