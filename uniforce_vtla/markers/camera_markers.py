"""Camera frame → canonical marker image and marker centres, by classical filters only (one thread, real time).

A frame of any size is scaled to fit 640×480 with its aspect kept, segmented there, and put in the middle of a black
480×640 image: a 1280×720 frame fills rows 60…419. Markers are white whatever their colour was.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.errors import ContractError, SensorError, expected
from uniforce_vtla.markers.marker_blobs import (
    Blobs,
    MarkerPlan,
    SegmentationSettings,
    channel_image,
    find_blobs,
    grow_mask,
    keep_markers,
)
from uniforce_vtla.markers.marker_plan import choose_plan, score_blobs

MIN_SIDE_PX = 48  # a smaller frame can't hold a marker pattern
THUMBNAIL_SIZE = (16, 12)  # enough to tell one gel and lighting from another
ALIKE_LEVELS = 12.0  # grey levels, mean: a touch changes less, another sensor more
# the bright ring outside a dome's rim: an arc of blobs that aren't markers, cut off by its radius
ARC_BINS = 36  # 10° each
MIN_ARC_BINS = 9  # a quarter circle: fewer bins are reflections, not a rim
STRIDE_PX = 3  # every third pixel both ways is plenty for a circle
MIN_RING_PX = 25  # sampled pixels needed to fit a circle
BLACK_LEVEL = 12  # grey levels: no pixel brighter means the lights or the camera are off


@dataclass(frozen=True)
class Segmentation:
    """Markers of one camera frame."""

    image: np.ndarray  # (480, 640) uint8 in {0, 255}
    centres_px: np.ndarray  # (M, 2) float32, x, y in the canonical image
    plan: MarkerPlan  # how they were found


def check_frame(frame: np.ndarray) -> np.ndarray:
    """Return an (H, W, 3) uint8 frame that isn't empty or dark.

    Raises:
        ContractError: wrong type, rank, dtype or size.
        SensorError: an all-black or completely even frame.
    """
    shape, dtype = getattr(frame, "shape", None), getattr(frame, "dtype", type(frame).__name__)
    if not isinstance(frame, np.ndarray) or frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
        do = "Pass the camera's RGB frame, not scaled to floats."
        raise ContractError(expected("camera frame", "(H, W, 3) uint8", f"{dtype} {shape}", do))
    if min(frame.shape[:2]) < MIN_SIDE_PX:
        wanted = f"at least {MIN_SIDE_PX} px a side"
        raise ContractError(expected("camera frame", wanted, shape, "Check the camera's resolution."))
    if frame.max() <= BLACK_LEVEL or frame.min() == frame.max():
        came = "an all-black frame" if frame.max() <= BLACK_LEVEL else "one even colour"
        raise SensorError(expected("camera frame", "a lit gel", came, "Check the sensor's lights and cable."))
    return frame


def segment(
    frame: np.ndarray, settings: SegmentationSettings, dome: bool, plan: MarkerPlan | None
) -> Segmentation:
    """Return the markers of an (H, W, 3) uint8 RGB frame.

    Args:
        frame: the camera's frame.
        settings: thresholds.
        dome: look for a bright rim around the markers and leave it out.
        plan: how to look, from the reference frame; None finds it in this frame.

    Raises:
        ContractError: see ``check_frame``.
        SensorError: dark frame, or no markers.
    """
    working = fit_canonical(check_frame(frame))
    chosen = plan or choose_plan(working, settings)[0]
    blobs = find_blobs(channel_image(working, chosen.channel), chosen, settings)
    keep = np.zeros(0, bool) if blobs is None else keep_markers(blobs, settings)
    if blobs is not None and dome:
        keep = inside_rim(blobs, keep)
    if blobs is None or score_blobs(blobs, keep, settings) == 0:
        came = f"{int(keep.sum())} blobs without the spacing of a pattern"
        do = "Is the gel torn, unlit, or without markers?"
        raise SensorError(expected("camera frame", "markers on the gel", came, do))
    mask = np.concatenate([[0], np.where(keep, 255, 0)]).astype(np.uint8)[blobs.labels]
    image, offset = centre_on_canvas(grow_mask(mask, blobs.foot, blobs.centres[keep], settings))
    return Segmentation(image, (blobs.centres[keep] + offset).astype(np.float32), chosen)


def fit_canonical(frame: np.ndarray) -> np.ndarray:
    """Return ``frame`` scaled to the largest size inside 640×480 with its aspect kept."""
    rows, columns = frame.shape[:2]
    scale = min(MARKER_IMAGE_SHAPE[0] / rows, MARKER_IMAGE_SHAPE[1] / columns)
    if scale == 1:
        return frame
    size = (round(columns * scale), round(rows * scale))
    return cv2.resize(frame, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)


def thumbnail(frame: np.ndarray) -> np.ndarray:
    """Return a small (12, 16, 3) int16 picture of a frame's light and colour."""
    coarse = cv2.resize(frame, (160, 120), interpolation=cv2.INTER_NEAREST)  # cheap first step
    return cv2.resize(coarse, THUMBNAIL_SIZE, interpolation=cv2.INTER_AREA).astype(np.int16)


def looks_alike(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether two thumbnails may come from one camera and gel."""
    return float(np.abs(first - second).mean()) <= ALIKE_LEVELS


def centre_on_canvas(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a mask in the middle of a black canonical image, and its (x, y) offset in px."""
    top, left = ((full - part) // 2 for full, part in zip(MARKER_IMAGE_SHAPE, mask.shape, strict=True))
    image = np.zeros(MARKER_IMAGE_SHAPE, np.uint8)
    image[top : top + mask.shape[0], left : left + mask.shape[1]] = mask
    return image, np.array([left, top], np.float32)


def inside_rim(blobs: Blobs, keep: np.ndarray) -> np.ndarray:
    """Return ``keep`` without blobs that lie on or outside the rim; unchanged where no rim shows."""
    if keep.sum() < 4:
        return keep
    ring = _ring_pixels(blobs, keep)
    if len(ring) < MIN_RING_PX:
        return keep
    centre, radius = fit_circle(ring)
    offset = ring - centre
    distance = np.hypot(*offset.T)
    bins = np.unique(
        np.floor((np.arctan2(offset[:, 1], offset[:, 0]) / np.pi + 1) / 2 * ARC_BINS).astype(int)
    )
    if len(bins) < MIN_ARC_BINS or distance.std() > 0.06 * radius:
        return keep  # scattered reflections don't lie on one circle
    inner = np.percentile(distance, 2)
    marker_radius = np.sqrt(np.median(blobs.boxes[keep, 4]) / np.pi)
    return keep & (np.hypot(*(blobs.centres - centre).T) < inner - 0.5 * marker_radius)


def fit_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre (2,) and radius of the algebraic least-squares circle through (N, 2) points."""
    mean = points.mean(axis=0)
    x, y = (points - mean).T
    system = np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1)
    (a, b, c), *_ = np.linalg.lstsq(system, x**2 + y**2, rcond=None)
    return mean + np.array([a, b]), float(np.sqrt(max(c + a**2 + b**2, 0.0)))


def _ring_pixels(blobs: Blobs, keep: np.ndarray) -> np.ndarray:
    """Return (N, 2) x, y of sampled pixels in refused blobs, no smaller than a marker, outside nearly all markers.

    Smaller ones are crumbs of light: counted as rim, they would draw it over the outer pins.
    """
    area = blobs.boxes[:, 4]
    large = ~keep & (area >= np.median(area[keep]))
    refused = np.concatenate([[False], large])[blobs.labels[::STRIDE_PX, ::STRIDE_PX]]
    y, x = np.nonzero(refused)
    points = np.stack([x, y], axis=1).astype(float) * STRIDE_PX
    middle = np.median(blobs.centres[keep], axis=0)
    reach = np.percentile(np.hypot(*(blobs.centres[keep] - middle).T), 85)
    return points[np.hypot(*(points - middle).T) > reach]
