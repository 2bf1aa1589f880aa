"""Blobs that stand out in a camera frame, and which of them are markers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

# thresholds of the marker finder: lengths in px of the canonical image, the rest relative
SMOOTH_FRACTION = 0.08  # of the background width: 3, 3 and 7 px, below the markers each is for
# two blobs are apart where the response between them falls below this peak share
PEAK_FRACTION = 0.5
EDGE_FRACTION = 0.08  # and its skirt is followed down to this share, which blurred markers need
FLOOR_FRACTION = 0.25  # of the typical peak: weaker blobs aren't markers
CEILING_FRACTION = 0.5  # of the typical peak: keeps a reflection from hiding the markers beside it
OUTLIER_FRACTION = 1.5  # of the typical peak: brighter is a reflection, held there
AGAINST_FRACTION = 0.5  # the same the other way: a streak over dark markers
MIN_CONTRAST = 6.0  # grey levels; camera noise after smoothing stays below
MIN_MARKERS = 12  # fewer can't show a pattern
AREA_RANGE = (0.25, 3.5)  # of the median area
ELONGATION_MAX = 3.0  # of the median elongation: streaks go, dashes stay
CUT_FRACTION = 0.4  # of the least area: the image border cuts markers
CUT_SIDE_MAX = 2.0  # of the median marker's side: a cut marker is no longer than a whole one
MIN_EXTENT = 0.5  # of the median share of its box a blob fills: slanted streaks go
GROW_PX = 2  # farthest that edge may lie outside the half-height contour
GROW_SPACING_PX = 11.0  # one px of growth per this much spacing, so that neighbours don't merge
ISOLATION_MAX = 2.6  # of the median neighbour distance: lone blobs go


@dataclass(frozen=True)
class MarkerPlan:
    """One way to see markers: channel, polarity (+1 bright, −1 dark), background width in px."""

    channel: str
    polarity: int
    background_px: int


@dataclass(frozen=True)
class Blobs:
    """Connected components of one threshold pass, and which of them are markers."""

    labels: np.ndarray  # (h, w) uint16, 0 is background
    boxes: np.ndarray  # (N, 5) int32, cv2 statistics of labels 1…N: left, top, width, height, area
    centres: np.ndarray  # (N, 2) float64, x, y
    typical: float  # amplitude of a typical marker, grey levels
    leftover: float  # mean response outside all blobs, grey levels
    # (h, w) uint8, 255 where the response exceeds the edge fraction of the peak nearby
    foot: np.ndarray
    keep: np.ndarray  # (N,) bool: blobs that agree with the rest in size, shape and spacing

    @property
    def markers(self) -> np.ndarray:
        """(M, 2) float64 x, y of the kept ones."""
        return self.centres[self.keep]

    @property
    def marker_area(self) -> float:
        """Median area of the kept ones, px²."""
        return float(np.median(self.boxes[self.keep, 4]))

    def without(self, extra: np.ndarray) -> Blobs:
        """Return these blobs with the (M,) bool ``extra`` of the kept ones no longer kept."""
        keep = self.keep.copy()
        keep[np.flatnonzero(keep)[extra]] = False
        return replace(self, keep=keep)


def channel_image(frame: np.ndarray, channel: str) -> np.ndarray:
    """Return one (h, w) uint8 view of an (h, w, 3) RGB frame."""
    if channel == "gray":
        return cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    red, green, blue = cv2.split(frame)
    if channel == "blue":
        return blue
    if channel == "value":
        return cv2.max(cv2.max(red, green), blue)
    if channel == "least":  # a coloured reflection lights one channel more than the others
        return cv2.min(cv2.min(red, green), blue)
    # yellow − blue
    return cv2.addWeighted(cv2.addWeighted(red, 0.5, green, 0.5, 0), 0.5, blue, -0.5, 128)


def find_blobs(
    view: np.ndarray, plan: MarkerPlan, halve: int = 1, marker_area: float | None = None
) -> Blobs | None:
    """Return the blobs of ``view`` under ``plan``; None where nothing stands out or no two agree.

    ``halve`` is 2 when the view is at half the canonical resolution. ``marker_area`` is a marker's
    px² in a reference; without it most blobs decide, and specks of a fuzzy object may outvote
    markers. The threshold is half of the strongest response nearby, whatever light and focus.
    """
    width = plan.background_px // halve | 1
    side = max(3, int(SMOOTH_FRACTION * width) | 1)
    smooth = cv2.blur(view, (side, side))
    response = _response(smooth, cv2.blur(smooth, (width, width)), plan.polarity)
    nearby = cv2.dilate(response, np.ones((width // 3 | 1, width // 3 | 1), np.uint8))
    typical = _typical_peak(response[(response == nearby) & (response >= MIN_CONTRAST / 2)])
    if typical < MIN_CONTRAST:
        return None
    if halve == 1:  # the final pass: reflections and streaks would shade the markers beside them
        smooth = _tame_outliers(smooth, width, plan.polarity * typical)
        response = _response(smooth, cv2.blur(smooth, (width, width)), plan.polarity)
        nearby = cv2.dilate(response, np.ones((width // 3 | 1, width // 3 | 1), np.uint8))
    floor = FLOOR_FRACTION * typical
    ceiling = CEILING_FRACTION * typical
    threshold = np.clip(np.arange(256) * PEAK_FRACTION, floor, ceiling).astype(np.uint8)
    mask = cv2.compare(response, cv2.LUT(nearby, threshold), cv2.CMP_GT)
    edge = np.clip(np.arange(256) * EDGE_FRACTION, EDGE_FRACTION * floor, ceiling).astype(np.uint8)
    foot = cv2.compare(response, cv2.LUT(nearby, edge), cv2.CMP_GT)
    _, labels, boxes, centres = cv2.connectedComponentsWithStats(
        mask, connectivity=8, ltype=cv2.CV_16U
    )
    leftover = cv2.mean(response, cv2.bitwise_not(mask))[0]
    keep = _alike(boxes[1:], mask.shape, marker_area)
    keep = _has_neighbours(centres[1:], keep)
    if not keep.any():
        return None
    return Blobs(labels, boxes[1:], centres[1:], typical, leftover, foot, keep)


def _alike(
    boxes: np.ndarray, shape: tuple[int, ...], marker_area: float | None = None
) -> np.ndarray:
    """Return (N,) bool: blobs in an (h, w) image that agree in size and shape with most others."""
    left, top, width, height, area = boxes.T
    solid = area >= 4
    if solid.sum() < MIN_MARKERS:
        return np.zeros(len(area), bool)
    median = marker_area or np.median(area[solid])
    sides = boxes[:, 2:4].astype(float)
    # a blob at one border may be a cut marker, one at two is a dark corner
    touched = [left == 0, top == 0, left + width == shape[1], top + height == shape[0]]
    borders = np.sum(touched, axis=0)
    lowest, highest = AREA_RANGE
    least = np.where(borders == 1, lowest * CUT_FRACTION, lowest) * median
    sized = solid & (area >= least) & (area <= highest * median)
    if not sized.any():
        return sized
    voters = solid if marker_area is None else sized
    elongation = sides.max(axis=1) / sides.min(axis=1)
    shapely = elongation <= ELONGATION_MAX * np.median(elongation[voters])
    cut = (borders == 1) & (sides.max(axis=1) <= CUT_SIDE_MAX * np.sqrt(median))
    extent = area / sides.prod(axis=1)
    full = extent >= MIN_EXTENT * np.median(extent[voters])
    return sized & (shapely | cut) & (borders < 2) & full


def marker_mask(blobs: Blobs) -> np.ndarray:
    """Return the (h, w) mask in {0, 255} of the kept blobs, grown out to the markers' edges.

    Growth stays inside the foot and within ``GROW_PX``, less where markers stand close. Blurred
    markers gain their skirts, sharp ones keep their size.
    """
    white = np.concatenate([[False], blobs.keep]) * np.uint8(255)  # by label
    mask = np.take(white, blobs.labels)
    grow = min(GROW_PX, int(spacing(blobs.markers) / GROW_SPACING_PX))
    if grow == 0:
        return mask
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * grow + 1, 2 * grow + 1))
    return cv2.bitwise_or(mask, cv2.bitwise_and(blobs.foot, cv2.dilate(mask, kernel)))


def spacing(points: np.ndarray) -> float:
    """Return the median distance of (M, 2) points to their nearest neighbours."""
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))


def _response(smooth: np.ndarray, background: np.ndarray, polarity: int) -> np.ndarray:
    """Return how far pixels stand out in their surroundings, uint8: a one-sided difference."""
    if polarity > 0:
        return cv2.subtract(smooth, background)
    return cv2.subtract(background, smooth)


def _tame_outliers(smooth: np.ndarray, width: int, amplitude: float) -> np.ndarray:
    """Return ``smooth`` held within the range that gel and markers of ``amplitude`` explain."""
    background = cv2.blur(smooth, (width, width))
    above = OUTLIER_FRACTION * abs(amplitude)
    below = AGAINST_FRACTION * abs(amplitude)
    if amplitude <= 0:
        above, below = below, above
    levels = np.arange(256)  # tables: OpenCV adds scalars to images the slow way
    highest = cv2.LUT(background, np.clip(levels + above, 0, 255).astype(np.uint8))
    lowest = cv2.LUT(background, np.clip(levels - below, 0, 255).astype(np.uint8))
    return cv2.max(cv2.min(smooth, highest), lowest)


def _typical_peak(peaks: np.ndarray) -> float:
    """Return the median of the stronger of two groups of peaks (Otsu, log amplitude); 0 if few."""
    histogram = np.bincount(peaks, minlength=256).astype(float)
    if histogram.sum() < 4:
        return 0.0
    level = np.log(np.maximum(np.arange(256), 1))
    count = np.cumsum(histogram)
    mass = np.cumsum(histogram * level)
    below = np.maximum(count, 1)
    above = np.maximum(count[-1] - count, 1)
    between = count * (count[-1] - count) * ((mass[-1] - mass) / above - mass / below) ** 2
    if between.max() > 0:
        histogram[: np.argmax(between) + 1] = 0
    return float(np.searchsorted(np.cumsum(histogram), histogram.sum() / 2))


def _has_neighbours(centres: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Return (N,) bool: kept blobs whose second neighbour is about as near as everyone's."""
    if keep.sum() < 4:
        return keep
    distance = cKDTree(centres[keep]).query(centres[keep], k=3)[0][:, 2]
    near = keep.copy()
    near[keep] = distance <= ISOLATION_MAX * np.median(distance)
    return near
