"""Hand descriptor: what a few lines of geometry already say about force, without any learning.

Beside every learnt row stands this one, so that the tokenizer isn't credited for what it didn't
need to learn.
"""

from typing import NamedTuple

import cv2
import numpy as np

from uniforce_vtla.contracts import Finger, check_marker_image
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.marker_blobs import spacing
from uniforce_vtla.markers.mirror import to_canonical

DESCRIPTOR_NAMES = ("dx", "dy", "divergence", "curl", "area_change", "count")
# of the above: what is worth telling apart, px or ratios
NATURAL_UNITS = (1.0, 1.0, 0.01, 0.01, 0.05, 0.05)
MIN_BLOB_PX = 4  # smaller specks are no markers
MIN_MATCHES = 3  # an affine fit needs as many


class Blobs(NamedTuple):
    """Markers found: centres (M, 2) px and areas (M,) px."""

    centre_px: np.ndarray
    area_px: np.ndarray


def describe(reference: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return (T, 6) float32 descriptors of (T, H, W) images against one (H, W) reference.

    Mean motion in px, divergence and curl of an affine fit to it, mean log growth of markers'
    areas, share of markers found again.

    Raises ContractError: no marker images, or a reference with too few markers.
    """
    before = white_blobs(check_marker_image(reference, "reference"))
    if len(before.area_px) < MIN_MATCHES:
        do = "Capture it again."
        raise ContractError(
            expected("reference", f"at least {MIN_MATCHES} markers", len(before.area_px), do)
        )
    reach = spacing(before.centre_px)
    return np.stack(
        [_describe_one(before, white_blobs(check_marker_image(image)), reach) for image in current]
    )


def white_blobs(image: np.ndarray) -> Blobs:
    """Return the white blobs of a binary image."""
    _, _, stats, centres = cv2.connectedComponentsWithStats(image, connectivity=4)
    area = stats[1:, cv2.CC_STAT_AREA]  # the first is the background
    kept = area >= MIN_BLOB_PX
    return Blobs(centres[1:][kept], area[kept].astype(np.float64))


def match(before: Blobs, after: Blobs, reach_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Return indices (before, after) of mutual nearest neighbours within ``reach_px``."""
    if not len(after.area_px):
        return np.empty(0, int), np.empty(0, int)
    distance = np.linalg.norm(before.centre_px[:, None] - after.centre_px[None], axis=-1)
    nearest = distance.argmin(axis=1)
    mutual = distance.argmin(axis=0)[nearest] == np.arange(len(nearest))
    kept = np.flatnonzero(mutual & (distance.min(axis=1) <= reach_px))
    return kept, nearest[kept]


def _describe_one(before: Blobs, after: Blobs, reach_px: float) -> np.ndarray:
    i, j = match(before, after, reach_px)
    found = len(i) / len(before.area_px)
    if len(i) < MIN_MATCHES:
        return np.array([0, 0, 0, 0, 0, found], np.float32)
    position = before.centre_px[i] - before.centre_px[i].mean(axis=0)
    motion = after.centre_px[j] - before.centre_px[i]  # (M, 2) px
    # (2, 2): d motion / d xy
    slope, *_ = np.linalg.lstsq(position, motion - motion.mean(axis=0), rcond=None)
    # a log: uSkin's dots grow many times over
    growth = np.log(after.area_px[j] / before.area_px[i]).mean()
    dx, dy = motion.mean(axis=0)
    divergence, curl = slope[0, 0] + slope[1, 1], slope[0, 1] - slope[1, 0]
    return np.array([dx, dy, divergence, curl, growth, found], np.float32)


def descriptors(reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
    """Return (B, 6) float32 descriptors in the canonical frame, as ``describe``.

    Args:
        reference: (H, W) uint8 free-air image, as the sensor saw it.
        current: (B, H, W) uint8 images, as the sensor saw them.
        finger: finger that wore the sensor.
    """
    before = np.ascontiguousarray(to_canonical(reference, finger))
    after = np.ascontiguousarray(to_canonical(current, finger))
    return describe(before, after)
