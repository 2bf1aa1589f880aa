"""The bright ring outside a dome's rim: found as an arc of blobs that aren't markers, cut off by its radius."""

from __future__ import annotations

import numpy as np

from uniforce_vtla.markers.marker_blobs import Blobs

ARC_BINS = 36  # 10° each
MIN_ARC_BINS = 9  # a quarter circle: fewer bins are reflections, not a rim
STRIDE_PX = 3  # every third pixel both ways is plenty for a circle
MIN_RING_PX = 25  # sampled pixels needed to fit a circle


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
    """Return (N, 2) x, y of sampled pixels in blobs refused as markers that lie outside nearly all markers."""
    refused = np.concatenate([[False], ~keep])[blobs.labels[::STRIDE_PX, ::STRIDE_PX]]
    y, x = np.nonzero(refused)
    points = np.stack([x, y], axis=1).astype(float) * STRIDE_PX
    middle = np.median(blobs.centres[keep], axis=0)
    reach = np.percentile(np.hypot(*(blobs.centres[keep] - middle).T), 85)
    return points[np.hypot(*(points - middle).T) > reach]
