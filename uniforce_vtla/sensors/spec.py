"""Description of a tactile sensor, as far as this project needs it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from uniforce_vtla.sensors.material import Material


@dataclass(frozen=True, kw_only=True)
class TaxelSignal:
    """Meaning of a taxel's counts, relative to a uSkin's; x right, y up, z into the pad."""

    # (x, y) usual distance of neighbours: a taxel is drawn in a cell of this size
    pitch_mm: tuple[float, float]
    # uSkin counts that one count of x, y, z is drawn as
    worth: tuple[float, float, float] = (1.0, 1.0, 1.0)
    # of force taxels: a disc shows the mean of its surroundings, which the skin takes along
    spread_mm: float = 0.0
    tared: bool = False  # the sensor subtracts its own free air, so that all zeros are a live scan


@dataclass(frozen=True, kw_only=True)
class PointSignal:
    """Points tracked by the sensor's own program: displacements in mm, x right, y down, z in.

    They are dense: each marker is drawn as the mean of the points nearest to its place.
    """

    place_mm: np.ndarray  # (N, 2) where the points rest, as ``layout_mm``
    noise_mm: float = 0.005  # standard deviation of a displacement at rest


@dataclass(frozen=True, kw_only=True)
class SensorSpec:
    """Facts about one kind of sensor."""

    name: str  # registry name
    taxels: TaxelSignal | None = None  # markers are rendered from counts; None: a camera sees them
    points: PointSignal | None = None  # markers are rendered from displacements
    # of the usual camera frame, or (taxels or points, 3)
    raw_shape: tuple[int, ...] = (480, 640, 3)
    # (M, 2) rest position of each marker on the pad, x right, y down, 0 at the pad's centre;
    # taxels in order of counts
    layout_mm: np.ndarray
    px_per_mm: tuple[float, float]  # (x, y) scale from the pad to the 640×480 canonical image
    # of a marker at rest; a diamond is a square on its corner
    marker_shape: Literal["square", "disc", "diamond"]
    marker_size_mm: float  # side of a square or diamond, diameter of a disc
    pad_size_mm: tuple[float, float]  # (x, y) extent of the sensing surface
    fisheye: float = 0.0  # of the lens: relative shortening of image radius at the pad's rim
    dome_radius_mm: float | None = None  # radius of curvature of the skin; None for a flat pad
    rated_depth_mm: float  # deepest indentation the maker allows; deeper counts as excess force
    rate_hz: float = 30.0  # usual rate of the raw signal
    source: str  # where the numbers come from
    material: Material | None = None  # of its pad; None: real frames are read, nothing is simulated

    @property
    def signal(self) -> Literal["camera", "taxel", "points"]:
        """Form of the raw signal: frames of a camera, taxel counts, or displacements of points."""
        if self.points is not None:
            return "points"
        return "camera" if self.taxels is None else "taxel"
