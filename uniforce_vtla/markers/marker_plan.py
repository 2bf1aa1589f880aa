"""How markers differ from the gel in a camera frame: which channel, which polarity, which scale. Found, not set.

Every candidate is tried at half resolution and scored by how much its blobs look like markers: contrast against what
is left between them, agreement in size, and the even spacing of a pattern. Nothing assumes a grid or a count.
"""

from itertools import product

import cv2
import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.errors import SensorError, expected
from uniforce_vtla.markers.marker_blobs import MIN_MARKERS, Blobs, MarkerPlan, channel_image, find_blobs

BACKGROUNDS_PX = (19, 39, 79)  # box widths: from 331 pins to 25 large squares
CLOSE_SCORE = 0.8  # of the best: among plans this good the narrowest background wins
TRIES = 5  # plans tried at full resolution before giving up
BACKGROUND_PER_SIDE = 1.5  # background width per marker side: narrower hollows markers out
MIN_INLIERS = 0.5  # share of blobs that agree: pure noise reaches 0.46, patterns 0.75 and more
# median ratio of second to first neighbour distance: near 1 for rows, grids and hexagons under any smooth distortion
# (1.13 on a strongly pressed fisheye), 1.41 for points at random and ≥ 1.3 where random blobs keep apart
MAX_SPACING_RATIO = 1.25
AMPLE_CONTRAST = 45.0  # typical peak over leftover; more comes from reflections, not from markers
MIN_SCORE = 40.0  # gels without markers score 0, faint patterns 100 and more
CHANNELS = ("value", "gray", "blue", "yellow")


def score_blobs(blobs: Blobs) -> float:
    """Return how much the kept blobs look like a marker pattern; 0 where they can't be one."""
    inliers = blobs.keep.mean()
    if blobs.keep.sum() < MIN_MARKERS or inliers < MIN_INLIERS:
        return 0.0
    distance = cKDTree(blobs.markers).query(blobs.markers, k=3)[0]  # (M, 3), the first is the point itself
    ratio = np.median(distance[:, 2] / distance[:, 1])
    if ratio > MAX_SPACING_RATIO:
        return 0.0
    spread = np.median(np.abs(blobs.boxes[blobs.keep, 4] - blobs.marker_area)) / blobs.marker_area
    contrast = min(blobs.typical / (blobs.leftover + 1), AMPLE_CONTRAST)
    evenness = inliers**2 / ratio**6 / (1 + 2 * spread)
    return float(np.sqrt(blobs.keep.sum()) * contrast**1.5 * evenness)


def choose_plan(frame: np.ndarray) -> MarkerPlan:
    """Return the plan that shows markers best in an (h, w, 3) RGB working frame.

    All plans are ranked at half resolution; the first few must hold at full resolution too.

    Raises SensorError: no plan shows anything like a marker pattern.
    """
    half = cv2.resize(frame, (frame.shape[1] // 2, frame.shape[0] // 2), interpolation=cv2.INTER_AREA)
    views = {channel: channel_image(half, channel) for channel in CHANNELS}
    plans = [MarkerPlan(*parts) for parts in product(CHANNELS, (1, -1), BACKGROUNDS_PX)]
    scores, sides = np.array([_judge_plan(views[plan.channel], plan, 2) for plan in plans]).T
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
    """Return plan indices, first the close ones wide enough for the best plan's markers, narrowest first."""
    best = plans[int(np.argmax(scores))]
    widths = np.array([plan.background_px for plan in plans])
    same = np.array([plan.polarity == best.polarity for plan in plans])
    wide = widths >= BACKGROUND_PER_SIDE * sides[np.argmax(scores)]
    favoured = same & wide & (scores >= CLOSE_SCORE * scores.max())
    return sorted(range(len(plans)), key=lambda i: (not favoured[i], widths[i] if favoured[i] else 0, -scores[i]))


def _judge_plan(view: np.ndarray, plan: MarkerPlan, halve: int) -> tuple[float, float]:
    """Return a plan's score and the side of its markers in canonical px; zeros where it shows none."""
    blobs = find_blobs(view, plan, halve)
    return (0.0, 0.0) if blobs is None else (score_blobs(blobs), halve * float(np.sqrt(blobs.marker_area)))
