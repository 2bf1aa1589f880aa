"""Camera frame → markers and their canonical image, by classical filters (one thread, real time).

A frame of any size is scaled to fit 640×480 with its aspect kept, segmented there, and centred on a
black 480×640 image: a 1280×720 frame fills rows 60…419. Markers are white, whatever their colour.

How markers differ from the gel (channel, polarity, scale) is found, not set. Every candidate is
tried at half resolution and scored: contrast of its blobs, agreement in size, and the even spacing
of a pattern. Nothing assumes a grid or a count.
"""

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import ContractError, SensorError, described, expected
from uniforce_vtla.markers.marker_blobs import (
    MIN_MARKERS,
    Blobs,
    MarkerPlan,
    channel_image,
    find_blobs,
    marker_mask,
)

MIN_SIDE_PX = 48  # a smaller frame can't hold a marker pattern
# the bright ring outside a dome's rim: an arc of blobs that aren't markers, cut off by its radius
ARC_BINS = 36  # 10° each
MIN_ARC_BINS = 9  # a quarter circle: fewer bins are reflections, not a rim
STRIDE_PX = 3  # every third pixel both ways is plenty for a circle
MIN_RING_PX = 25  # sampled pixels needed to fit a circle
BLACK_LEVEL = 12  # grey levels: no pixel brighter means the lights or the camera are off


# centre (2,) x, y of the bright ring, and how far from it markers lie, px
type Rim = tuple[np.ndarray, float]


@dataclass(frozen=True)
class Segmentation:
    """Markers of one camera frame, in px of ``fit_canonical``'s frame, and how they were found."""

    blobs: Blobs
    plan: MarkerPlan
    rim: Rim | None

    @property
    def centres_px(self) -> np.ndarray:
        """(M, 2) float32 x, y in the canonical image."""
        return (self.blobs.markers + _margins(self.blobs.labels)[::-1]).astype(np.float32)

    def image(self) -> np.ndarray:
        """Return the (480, 640) uint8 image in {0, 255}: markers centred on a black canvas."""
        mask = marker_mask(self.blobs)
        top, left = _margins(mask)
        image = np.zeros(MARKER_IMAGE_SHAPE, np.uint8)
        image[top : top + mask.shape[0], left : left + mask.shape[1]] = mask
        return image


def segment(
    working: np.ndarray,
    dome: bool,
    plan: MarkerPlan | None = None,
    rim: Rim | None = None,
    marker_area: float | None = None,
) -> Segmentation:
    """Return the markers of an (h, w, 3) uint8 RGB frame from ``fit_canonical``.

    Args:
        working: the frame.
        dome: leave out what lies on or outside a bright rim around the markers.
        plan: how to look; None finds it in this frame.
        rim: where the rim is; None looks for it in this frame.
        marker_area: px² of a marker; None lets this frame's blobs decide.

    Raises SensorError: no markers.
    """
    plan = plan or choose_plan(working)
    blobs = find_blobs(channel_image(working, plan.channel), plan, marker_area=marker_area)
    if blobs is not None and dome:
        rim = rim or find_rim(blobs)
        if rim is not None:
            blobs = blobs.without(np.hypot(*(blobs.markers - rim[0]).T) >= rim[1])
    # specks of no marker's size don't count against it
    judge = score_blobs if marker_area is None else has_pattern
    if blobs is None or not judge(blobs):
        count = blobs.keep.sum() if blobs else 0
        came = f"{count} blobs without the spacing of a pattern"
        do = "Is the gel torn, unlit, or without markers?"
        raise SensorError(expected("camera frame", "markers on the gel", came, do))
    return Segmentation(blobs, plan, rim)


def fit_canonical(frame: np.ndarray) -> np.ndarray:
    """Return an (H, W, 3) uint8 frame scaled to the largest size inside 640×480, aspect kept.

    Raises ContractError: wrong type, rank, dtype or size; SensorError: a black or even frame.
    """
    if (
        not isinstance(frame, np.ndarray)
        or frame.ndim != 3
        or frame.shape[2] != 3
        or frame.dtype != np.uint8
    ):
        do = "Pass the camera's RGB frame, not scaled to floats."
        raise ContractError(expected("camera frame", "(H, W, 3) uint8", described(frame), do))
    rows, columns = frame.shape[:2]
    if min(rows, columns) < MIN_SIDE_PX:
        wanted = f"at least {MIN_SIDE_PX} px a side"
        raise ContractError(
            expected("camera frame", wanted, frame.shape, "Check the camera's resolution.")
        )
    is_black = frame.max() <= BLACK_LEVEL
    if is_black or frame.min() == frame.max():
        came = "an all-black frame" if is_black else "one even colour"
        raise SensorError(
            expected("camera frame", "a lit gel", came, "Check the sensor's lights and cable.")
        )
    scale = min(MARKER_IMAGE_SHAPE[0] / rows, MARKER_IMAGE_SHAPE[1] / columns)
    if scale == 1:
        return frame
    size = (round(columns * scale), round(rows * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(frame, size, interpolation=method)


def find_rim(blobs: Blobs) -> Rim | None:
    """Return the rim that refused blobs show around the kept ones; None where they show none."""
    if blobs.keep.sum() < 4:
        return None
    ring = _ring_pixels(blobs)
    if len(ring) < MIN_RING_PX:
        return None
    centre, radius = fit_circle(ring)
    offset = ring - centre
    distance = np.hypot(*offset.T)
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    bins = np.unique(np.floor((angle / np.pi + 1) / 2 * ARC_BINS).astype(int))
    if len(bins) < MIN_ARC_BINS or distance.std() > 0.06 * radius:
        return None  # scattered reflections don't lie on one circle
    return centre, float(np.percentile(distance, 2) - 0.5 * np.sqrt(blobs.marker_area / np.pi))


def fit_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre (2,) and radius of the algebraic least-squares circle through (N, 2) points."""
    mean = points.mean(axis=0)
    x, y = (points - mean).T
    system = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(system, x**2 + y**2, rcond=None)
    return mean + np.array([a, b]), float(np.sqrt(max(c + a**2 + b**2, 0.0)))


def _ring_pixels(blobs: Blobs) -> np.ndarray:
    """Return (N, 2) x, y of sampled pixels in refused blobs outside nearly all markers.

    Smaller ones are crumbs of light: counted as rim, they would draw it over the outer pins.
    """
    large = ~blobs.keep & (blobs.boxes[:, 4] >= blobs.marker_area)
    y, x = np.nonzero(np.concatenate([[False], large])[blobs.labels[::STRIDE_PX, ::STRIDE_PX]])
    points = np.stack([x, y], axis=1).astype(float) * STRIDE_PX
    middle = np.median(blobs.markers, axis=0)
    reach = np.percentile(np.hypot(*(blobs.markers - middle).T), 85)
    return points[np.hypot(*(points - middle).T) > reach]


def _margins(mask: np.ndarray) -> np.ndarray:
    """Return how many rows above and columns left of an (h, w) mask the canonical image adds."""
    return (np.array(MARKER_IMAGE_SHAPE) - mask.shape) // 2


BACKGROUNDS_PX = (19, 39, 79)  # box widths: from 331 pins to 25 large squares
CLOSE_SCORE = 0.8  # of the best: among plans this good the narrowest background wins
TRIES = 5  # plans tried at full resolution before giving up
BACKGROUND_PER_SIDE = 1.5  # background width per marker side: narrower hollows markers out
MIN_INLIERS = 0.5  # share of blobs that agree: pure noise reaches 0.46, patterns 0.75 and more
# median ratio of second to first neighbour distance: near 1 for rows, grids and hexagons (1.13 on
# a strongly pressed fisheye), 1.41 for random points, ≥ 1.3 where random blobs keep apart
MAX_SPACING_RATIO = 1.25
AMPLE_CONTRAST = 45.0  # typical peak over leftover; more comes from reflections, not from markers
MIN_SCORE = 40.0  # gels without markers score 0, faint patterns 100 and more
CHANNELS = ("value", "gray", "blue", "yellow")


def has_pattern(blobs: Blobs) -> bool:
    """Return whether the kept blobs are as many and as evenly spaced as markers."""
    return bool(blobs.keep.sum() >= MIN_MARKERS and _unevenness(blobs) <= MAX_SPACING_RATIO)


def _unevenness(blobs: Blobs) -> float:
    """Return the median ratio of a kept blob's second to its first neighbour's distance."""
    # (M, 3), the first is the point itself
    distance = cKDTree(blobs.markers).query(blobs.markers, k=3)[0]
    return float(np.median(distance[:, 2] / distance[:, 1]))


def score_blobs(blobs: Blobs) -> float:
    """Return how much the kept blobs look like a marker pattern; 0 where they can't be one."""
    inliers = blobs.keep.mean()
    if inliers < MIN_INLIERS or not has_pattern(blobs):
        return 0.0
    ratio = _unevenness(blobs)
    spread = np.median(np.abs(blobs.boxes[blobs.keep, 4] - blobs.marker_area)) / blobs.marker_area
    contrast = min(blobs.typical / (blobs.leftover + 1), AMPLE_CONTRAST)
    evenness = inliers**2 / ratio**6 / (1 + 2 * spread)
    return float(np.sqrt(blobs.keep.sum()) * contrast**1.5 * evenness)


def choose_plan(frame: np.ndarray) -> MarkerPlan:
    """Return the plan that shows markers best in an (h, w, 3) RGB working frame.

    All plans are ranked at half resolution; the first few must hold at full resolution too.

    Raises SensorError: no plan shows anything like a marker pattern.
    """
    half = cv2.resize(
        frame, (frame.shape[1] // 2, frame.shape[0] // 2), interpolation=cv2.INTER_AREA
    )
    views = {channel: channel_image(half, channel) for channel in CHANNELS}
    plans = [MarkerPlan(*parts) for parts in product(CHANNELS, (1, -1), BACKGROUNDS_PX)]
    judged = [_judge_plan(views[plan.channel], plan, 2) for plan in plans]
    scores, sides = np.array(judged).T
    best = 0.0
    for index in _by_promise(plans, scores, sides)[:TRIES]:
        score, _ = _judge_plan(channel_image(frame, plans[index].channel), plans[index], 1)
        if min(score, scores[index]) >= MIN_SCORE:
            return plans[index]
        best = max(best, score)
    came = f"no pattern of dots in any channel (score {best:.1f}, needs {MIN_SCORE:g})"
    do = "Is this a gel without markers, out of focus, or unlit?"
    raise SensorError(expected("camera frame", "markers on the gel", came, do))


def _by_promise(plans: list[MarkerPlan], scores: np.ndarray, sides: np.ndarray) -> list[int]:
    """Return plan indices: first the close ones wide enough for the best one's markers.

    Of these the narrowest comes first; the others follow by score.
    """
    best = int(np.argmax(scores))
    widths = np.array([plan.background_px for plan in plans])
    polarities = np.array([plan.polarity for plan in plans])
    same = polarities == polarities[best]
    wide = widths >= BACKGROUND_PER_SIDE * sides[best]
    favoured = same & wide & (scores >= CLOSE_SCORE * scores.max())
    return np.lexsort((-scores, widths * favoured, ~favoured)).tolist()


def _judge_plan(view: np.ndarray, plan: MarkerPlan, halve: int) -> tuple[float, float]:
    """Return a plan's score and its markers' side in canonical px; zeros where it shows none."""
    blobs = find_blobs(view, plan, halve)
    if blobs is None:
        return 0.0, 0.0
    return score_blobs(blobs), halve * float(np.sqrt(blobs.marker_area))
