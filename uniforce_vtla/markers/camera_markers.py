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
from uniforce_vtla.markers.rim import inside_rim

MIN_SIDE_PX = 48  # a smaller frame can't hold a marker pattern
THUMBNAIL_SIZE = (16, 12)  # enough to tell one gel and lighting from another
ALIKE_LEVELS = 12.0  # grey levels, mean: a touch changes less, another sensor more
BLACK_LEVEL = 12  # grey levels: no pixel brighter means the lights or the camera are off


@dataclass(frozen=True)
class Segmentation:
    """Markers of one camera frame.

    Attributes:
        image: (480, 640) uint8 in {0, 255}.
        centres_px: (M, 2) float32, x, y in the canonical image.
        plan: how they were found.
    """

    image: np.ndarray
    centres_px: np.ndarray
    plan: MarkerPlan


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
    keep = _kept(blobs, settings, dome)
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


def _kept(blobs: Blobs | None, settings: SegmentationSettings, dome: bool) -> np.ndarray:
    if blobs is None:
        return np.zeros(0, bool)
    keep = keep_markers(blobs, settings)
    return inside_rim(blobs, keep) if dome else keep
