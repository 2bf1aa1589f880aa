"""How markers differ from the gel in a camera frame: which channel, which polarity, which scale. Found, not set.

Every candidate is tried at half resolution and scored by how much its blobs look like markers: contrast against what
is left between them, agreement in size, and the even spacing of a pattern. Nothing assumes a grid or a count.
"""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.errors import SensorError, expected
from uniforce_vtla.markers.marker_blobs import (
    Blobs,
    MarkerPlan,
    SegmentationSettings,
    channel_image,
    find_blobs,
    keep_markers,
)

CHANNELS = ("value", "gray", "blue", "yellow")
POLARITIES = (1, -1)  # markers brighter or darker than the gel


def score_blobs(blobs: Blobs, keep: np.ndarray, settings: SegmentationSettings) -> float:
    """Return how much the kept blobs look like a marker pattern; 0 where they can't be one."""
    area = blobs.boxes[:, 4]
    inliers = keep.mean()
    if keep.sum() < settings.min_markers or inliers < settings.min_inliers:
        return 0.0
    ratio = spacing_ratio(blobs.centres[keep])
    if ratio > settings.max_spacing_ratio:
        return 0.0
    kept = area[keep]
    spread = np.median(np.abs(kept - np.median(kept))) / np.median(kept)
    contrast = min(blobs.typical / (blobs.leftover + 1), settings.ample_contrast)
    evenness = inliers**2 / ratio**6 / (1 + 2 * spread)
    return float(np.sqrt(keep.sum()) * contrast**1.5 * evenness)


def spacing_ratio(centres: np.ndarray) -> float:
    """Return the median ratio of second to first neighbour distance of (M, 2) points, M ≥ 3.

    Near 1 for rows, grids and hexagons under any smooth distortion (1.13 on a strongly pressed fisheye), 1.41 for
    points at random and ≥ 1.3 where random blobs keep apart.
    """
    distance = cKDTree(centres).query(centres, k=3)[0]  # (M, 3), the first is the point itself
    return float(np.median(distance[:, 2] / distance[:, 1]))


def choose_plan(frame: np.ndarray, settings: SegmentationSettings) -> tuple[MarkerPlan, float]:
    """Return the plan that shows markers best in an (h, w, 3) RGB working frame, and its score.

    All plans are ranked at half resolution; the first few must hold at full resolution too.

    Raises:
        SensorError: no plan shows anything like a marker pattern.
    """
    half = cv2.resize(frame, (frame.shape[1] // 2, frame.shape[0] // 2), interpolation=cv2.INTER_AREA)
    views = {channel: channel_image(half, channel) for channel in CHANNELS}
    plans = [MarkerPlan(*parts) for parts in product(CHANNELS, POLARITIES, settings.backgrounds_px)]
    scores, sides = np.array([_judge_plan(views[plan.channel], plan, settings, 2) for plan in plans]).T
    best = 0.0
    for index in _by_promise(plans, scores, sides, settings)[: settings.tries]:
        score, _ = _judge_plan(channel_image(frame, plans[index].channel), plans[index], settings, 1)
        if min(score, scores[index]) >= settings.min_score:
            return plans[index], score
        best = max(best, score)
    came = f"no pattern of dots in any channel (score {best:.1f}, needs {settings.min_score:g})"
    do = "Is this a gel without markers, out of focus, or unlit?"
    raise SensorError(expected("camera frame", "markers on the gel", came, do))


def _by_promise(
    plans: list[MarkerPlan], scores: np.ndarray, sides: np.ndarray, settings: SegmentationSettings
) -> list[int]:
    """Return plan indices, first the close ones wide enough for the best plan's markers, narrowest first."""
    best = plans[int(np.argmax(scores))]
    widths = np.array([plan.background_px for plan in plans])
    same = np.array([plan.polarity == best.polarity for plan in plans])
    wide = widths >= settings.background_per_side * sides[np.argmax(scores)]
    favoured = same & wide & (scores >= settings.close_score * scores.max())
    return sorted(
        range(len(plans)), key=lambda i: (not favoured[i], widths[i] if favoured[i] else 0, -scores[i])
    )


def _judge_plan(
    view: np.ndarray, plan: MarkerPlan, settings: SegmentationSettings, halve: int
) -> tuple[float, float]:
    """Return a plan's score and the side of its markers in canonical px; zeros where it shows none."""
    blobs = find_blobs(view, plan, settings, halve)
    keep = np.zeros(0, bool) if blobs is None else keep_markers(blobs, settings)
    if blobs is None or not keep.any():
        return 0.0, 0.0
    return score_blobs(blobs, keep, settings), halve * float(np.sqrt(np.median(blobs.boxes[keep, 4])))
