"""Blobs that stand out in a camera frame, and which of them are markers: settings, filters and shape checks."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree


@dataclass(frozen=True)
class SegmentationSettings:
    """Every threshold of the marker finder; lengths in px of the canonical image, the rest relative."""

    backgrounds_px: tuple[int, ...] = (19, 39, 79)  # box widths: from 331 pins to 25 large squares
    smooth_fraction: float = 0.08  # of the background width: 3, 3 and 7 px, below the markers each is for
    peak_fraction: float = (
        0.5  # two blobs are apart where the response between them falls below this peak share
    )
    edge_fraction: float = 0.08  # and its skirt is followed down to this share, which blurred markers need
    floor_fraction: float = 0.25  # of the typical peak: weaker blobs aren't markers
    ceiling_fraction: float = 0.5  # of the typical peak: keeps a reflection from hiding the markers beside it
    close_score: float = 0.8  # of the best: among plans this good the narrowest background wins
    tries: int = 5  # plans tried at full resolution before giving up
    background_per_side: float = 1.5  # background width per marker side: narrower hollows markers out
    outlier_fraction: float = 1.5  # of the typical peak: brighter is a reflection, held there
    against_fraction: float = 0.5  # the same the other way: a streak over dark markers
    min_contrast: float = 6.0  # grey levels; camera noise after smoothing stays below
    min_markers: int = 12  # fewer can't show a pattern
    area_range: tuple[float, float] = (0.25, 3.5)  # of the median area
    elongation_max: float = 3.0  # of the median elongation: streaks go, dashes stay
    cut_fraction: float = 0.4  # of the least area: the image border cuts markers
    cut_side_max: float = 2.0  # of the median marker's side: a cut marker is no longer than a whole one
    min_extent: float = 0.5  # of the median share of its box a blob fills: slanted streaks go
    grow_px: int = 2  # farthest that edge may lie outside the half-height contour
    grow_spacing_px: float = 11.0  # one px of growth per this much spacing, so that neighbours don't merge
    isolation_max: float = 2.6  # of the median neighbour distance: lone blobs go
    min_inliers: float = 0.5  # share of blobs that agree: pure noise reaches 0.46, patterns 0.75 and more
    max_spacing_ratio: float = 1.25  # second to first neighbour: ≤ 1.13 in patterns, ≥ 1.3 in scattered dirt
    ample_contrast: float = 45.0  # typical peak over leftover; more comes from reflections, not from markers
    min_score: float = 40.0  # gels without markers score 0, faint patterns 100 and more


@dataclass(frozen=True)
class MarkerPlan:
    """One way to see the markers: a channel, a polarity (+1 bright, −1 dark) and a background width in px."""

    channel: str
    polarity: int
    background_px: int


@dataclass(frozen=True)
class Blobs:
    """Connected components of one threshold pass."""

    labels: np.ndarray  # (h, w) uint16, 0 is background
    boxes: np.ndarray  # (N, 5) int32, cv2 statistics of labels 1…N: left, top, width, height, area
    centres: np.ndarray  # (N, 2) float64, x, y
    typical: float  # amplitude of a typical marker, grey levels
    leftover: float  # mean response outside all blobs, grey levels
    foot: np.ndarray  # (h, w) uint8, 255 where the response exceeds the edge fraction of the peak nearby


def channel_image(frame: np.ndarray, channel: str) -> np.ndarray:
    """Return one (h, w) uint8 view of an (h, w, 3) RGB frame."""
    if channel == "gray":
        return cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    red, green, blue = cv2.split(frame)
    if channel == "blue":
        return blue
    if channel == "value":
        return cv2.max(cv2.max(red, green), blue)
    return cv2.addWeighted(cv2.addWeighted(red, 0.5, green, 0.5, 0), 0.5, blue, -0.5, 128)  # yellow − blue


def find_blobs(
    view: np.ndarray, plan: MarkerPlan, settings: SegmentationSettings, halve: int = 1
) -> Blobs | None:
    """Return the blobs of ``view`` under ``plan``; None where nothing stands out.

    ``halve`` is 2 when the view is at half the canonical resolution. The threshold is local: half of the strongest
    response nearby, so that vignetting and blur don't change a marker's size.
    """
    width = plan.background_px // halve | 1
    side = max(3, int(settings.smooth_fraction * width) | 1)
    smooth = cv2.blur(view, (side, side))
    response = _response(smooth, cv2.blur(smooth, (width, width)), plan.polarity)
    nearby = cv2.dilate(response, np.ones((width // 3 | 1, width // 3 | 1), np.uint8))
    typical = _typical_peak(response[(response == nearby) & (response >= settings.min_contrast / 2)])
    if typical < settings.min_contrast:
        return None
    if halve == 1:  # the final pass: reflections and streaks would shade the markers beside them
        smooth = _tame_outliers(smooth, width, plan.polarity * typical, settings)
        response = _response(smooth, cv2.blur(smooth, (width, width)), plan.polarity)
        nearby = cv2.dilate(response, np.ones((width // 3 | 1, width // 3 | 1), np.uint8))
    floor, ceiling = settings.floor_fraction * typical, settings.ceiling_fraction * typical
    threshold = np.clip(np.arange(256) * settings.peak_fraction, floor, ceiling).astype(np.uint8)
    mask = cv2.compare(response, cv2.LUT(nearby, threshold), cv2.CMP_GT)
    edge = np.clip(np.arange(256) * settings.edge_fraction, settings.edge_fraction * floor, ceiling).astype(
        np.uint8
    )
    foot = cv2.compare(response, cv2.LUT(nearby, edge), cv2.CMP_GT)
    count, labels, boxes, centres = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=cv2.CV_16U)
    leftover = cv2.mean(response, cv2.bitwise_not(mask))[0]
    return Blobs(labels, boxes[1:], centres[1:], typical, leftover, foot) if count > 1 else None


def keep_markers(blobs: Blobs, settings: SegmentationSettings) -> np.ndarray:
    """Return (N,) bool: blobs that agree with the rest in size, shape and spacing."""
    area = blobs.boxes[:, 4]
    solid = area >= 4
    if solid.sum() < settings.min_markers:
        return np.zeros(len(area), bool)
    median, sides, borders = (
        np.median(area[solid]),
        blobs.boxes[:, 2:4].astype(float),
        _borders_touched(blobs),
    )
    lowest, highest = settings.area_range
    least = np.where(borders == 1, lowest * settings.cut_fraction, lowest) * median
    keep = solid & (area >= least) & (area <= highest * median)
    elongation = sides.max(axis=1) / sides.min(axis=1)
    shapely = elongation <= settings.elongation_max * np.median(elongation[solid])
    cut = (borders == 1) & (sides.max(axis=1) <= settings.cut_side_max * np.sqrt(median))
    extent = area / sides.prod(axis=1)
    keep &= (shapely | cut) & (borders < 2) & (extent >= settings.min_extent * np.median(extent[solid]))
    return keep & _has_neighbours(blobs.centres, keep, settings)


def grow_mask(
    mask: np.ndarray, foot: np.ndarray, centres: np.ndarray, settings: SegmentationSettings
) -> np.ndarray:
    """Return an (h, w) mask grown out to the markers' edges.

    ``foot`` holds every pixel above the edge fraction; growth stays inside it and within ``grow_px``, less where
    (M, 2) markers stand close. So blurred markers gain their skirts and sharp ones keep their size.
    """
    spacing = float(np.median(cKDTree(centres).query(centres, k=2)[0][:, 1]))
    grow = min(settings.grow_px, int(spacing / settings.grow_spacing_px))
    if grow == 0:
        return mask
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * grow + 1, 2 * grow + 1))
    return cv2.bitwise_or(mask, cv2.bitwise_and(foot, cv2.dilate(mask, kernel)))


def _response(smooth: np.ndarray, background: np.ndarray, polarity: int) -> np.ndarray:
    """Return the one-sided difference of box filters, uint8: how far a pixel stands out in its surroundings."""
    return cv2.subtract(smooth, background) if polarity > 0 else cv2.subtract(background, smooth)


def _tame_outliers(
    smooth: np.ndarray, width: int, amplitude: float, settings: SegmentationSettings
) -> np.ndarray:
    """Return ``smooth`` held within the range that markers of signed ``amplitude`` and gel explain."""
    background = cv2.blur(smooth, (width, width))
    beyond = settings.outlier_fraction * abs(amplitude)
    against = settings.against_fraction * abs(amplitude)
    above, below = (beyond, against) if amplitude > 0 else (against, beyond)
    levels = np.arange(256)  # tables: OpenCV adds scalars to images the slow way
    highest = cv2.LUT(background, np.clip(levels + above, 0, 255).astype(np.uint8))
    lowest = cv2.LUT(background, np.clip(levels - below, 0, 255).astype(np.uint8))
    return cv2.max(cv2.min(smooth, highest), lowest)


def _typical_peak(peaks: np.ndarray) -> float:
    """Return the median of the stronger of two groups of peaks (Otsu's split in log amplitude); 0 if too few."""
    histogram = np.bincount(peaks, minlength=256).astype(float)
    if histogram.sum() < 4:
        return 0.0
    level = np.log(np.maximum(np.arange(256), 1))
    count, mass = np.cumsum(histogram), np.cumsum(histogram * level)
    below, above = np.maximum(count, 1), np.maximum(count[-1] - count, 1)
    between = count * (count[-1] - count) * ((mass[-1] - mass) / above - mass / below) ** 2
    strong = histogram * (np.arange(256) > int(np.argmax(between))) if between.max() > 0 else histogram
    return float(np.searchsorted(np.cumsum(strong), strong.sum() / 2))


def _borders_touched(blobs: Blobs) -> np.ndarray:
    """Return (N,) how many image borders each blob touches: 1 may be a cut marker, 2 is a dark corner."""
    rows, columns = blobs.labels.shape
    left, top, width, height = blobs.boxes[:, :4].T
    touched = np.stack([left == 0, top == 0, left + width == columns, top + height == rows])
    return touched.sum(axis=0)


def _has_neighbours(centres: np.ndarray, keep: np.ndarray, settings: SegmentationSettings) -> np.ndarray:
    """Return (N,) bool: kept blobs whose second neighbour is about as near as everyone's."""
    if keep.sum() < 4:
        return keep
    distance = cKDTree(centres[keep]).query(centres[keep], k=3)[0][:, 2]
    near = keep.copy()
    near[keep] = distance <= settings.isolation_max * np.median(distance)
    return near
