"""What a tactile sensor is, as far as this project needs to know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

DASH_ASPECT = 2.5  # width over height; printed dashes of real gels are about that long


@dataclass(frozen=True)
class SensorSpec:
    """Facts about one kind of sensor; simulation-only material numbers live in ``contact/``.

    Attributes:
        name: registry name.
        signal: "camera" (markers are found in an image) or "taxel" (markers are rendered from counts).
        raw_shape: (rows, columns, 3) of the usual camera frame, or (taxels, 3).
        layout_mm: (M, 2) rest position of each marker on the pad, x right, y down, 0 at the pad's centre.
        px_per_mm: (x, y) scale from the pad to the 640×480 canonical image.
        marker_shape: what a marker looks like at rest; a diamond is a square on its corner, a dash a bar
            ``DASH_ASPECT`` times as wide as high.
        marker_size_mm: side of a square or diamond, diameter of a disc, or width of a dash.
        pad_size_mm: (x, y) extent of the sensing surface.
        dome_radius_mm: radius of curvature of the skin; None for a flat pad.
        rated_depth_mm: deepest indentation the maker allows; deeper counts as excess force.
        rate_hz: usual rate of the raw signal.
        source: where the numbers come from.
    """

    name: str
    signal: Literal["camera", "taxel"]
    raw_shape: tuple[int, ...]
    layout_mm: np.ndarray
    px_per_mm: tuple[float, float]
    marker_shape: Literal["square", "disc", "diamond", "dash"]
    marker_size_mm: float
    pad_size_mm: tuple[float, float]
    dome_radius_mm: float | None
    rated_depth_mm: float
    rate_hz: float
    source: str
