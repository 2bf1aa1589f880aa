"""What a tactile sensor is, as far as this project needs to know."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from uniforce_vtla.sensors.material import PadMaterial, TaxelMaterial


@dataclass(frozen=True, kw_only=True)
class SensorSpec:
    """Facts about one kind of sensor."""

    name: str  # registry name
    # "camera" (markers are found in an image) or "taxel" (markers are rendered from counts)
    signal: Literal["camera", "taxel"] = "camera"
    raw_shape: tuple[int, ...] = (480, 640, 3)  # of the usual camera frame, or (taxels, 3)
    # (M, 2) rest position of each marker on the pad, x right, y down, 0 at the pad's centre
    layout_mm: np.ndarray
    px_per_mm: tuple[float, float]  # (x, y) scale from the pad to the 640×480 canonical image
    # what a marker looks like at rest; a diamond is a square on its corner
    marker_shape: Literal["square", "disc", "diamond"]
    marker_size_mm: float  # side of a square or diamond, diameter of a disc
    pad_size_mm: tuple[float, float]  # (x, y) extent of the sensing surface
    fisheye: float = 0.0  # of the lens: relative shortening of image radius at the pad's rim
    dome_radius_mm: float | None = None  # radius of curvature of the skin; None for a flat pad
    rated_depth_mm: float  # deepest indentation the maker allows; deeper counts as excess force
    rate_hz: float = 30.0  # usual rate of the raw signal
    source: str  # where the numbers come from
    material: PadMaterial | TaxelMaterial | None = None  # of its pad; None: real frames are read, nothing is simulated
