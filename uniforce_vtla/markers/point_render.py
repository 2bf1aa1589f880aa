"""Tracked points → canonical marker image: drawn where a camera below the gel would see them.

Each marker moves as the mean of the points around it, and grows as their area does.
"""

from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from uniforce_vtla.errors import ContractError, described, expected
from uniforce_vtla.markers.raster import CENTRE_PX
from uniforce_vtla.markers.taxel_render import TaxelDiscs
from uniforce_vtla.sensors import SensorSpec, get_sensor

MOST_MM = 20.0  # either way: no pad is so soft
CAMERA_MM = 30.0  # from the points to the camera that the drawing pretends; a GelSight's
# points that rise by so much, and further than any sinks: their reference was pressed
PRESSED_MM = -0.05


def check_points(points_mm: np.ndarray, name: str, wanted: tuple[int, ...]) -> np.ndarray:
    """Return (N, 3) displacements in mm as float64.

    Raises ContractError: no float array of the ``wanted`` shape, not finite, or too far.
    """
    is_array = isinstance(points_mm, np.ndarray)
    if not is_array or points_mm.shape != wanted or points_mm.dtype.kind != "f":
        do = "Pass displacements in mm, one row (x, y, z) per point."
        raise ContractError(expected(name, f"floats {wanted}", described(points_mm), do))
    if not (np.abs(points_mm) <= MOST_MM).all():  # NaN is not
        came = f"{np.abs(points_mm).max():g} mm"
        raise ContractError(
            expected(name, f"within ±{MOST_MM:g} mm", came, "Pass displacements, not positions.")
        )
    return points_mm.astype(np.float64)


def is_pressed(moved_mm: np.ndarray) -> bool:
    """Return whether (N, 3) displacements from a reference show that the reference was pressed."""
    risen, sunk = np.quantile(moved_mm[:, 2], (0.02, 0.98))
    return bool(risen < PRESSED_MM and -risen > sunk)


def place_points(moved_mm: np.ndarray, spec: SensorSpec) -> TaxelDiscs:
    """Return the discs of (N, 3) displacements from the reference; x right, y down, z in."""
    mean, stretch = _of_markers(spec.name)
    moved = mean @ moved_mm
    nearer = moved[:, 2] / CAMERA_MM  # a marker pressed towards the camera looks larger
    seen_mm = (spec.layout_mm + moved[:, :2]) * (1 + nearer[:, None])
    # of the area that a marker covers
    strain = stretch[0] @ moved_mm[:, 0] + stretch[1] @ moved_mm[:, 1]
    growth = np.sqrt(np.clip(1 + strain, 0.25, 4.0)) * (1 + nearer)
    radii = spec.marker_size_mm * spec.px_per_mm[0] / 2 * growth
    centres_px = CENTRE_PX + seen_mm * spec.px_per_mm
    return TaxelDiscs(centres_px.astype(np.float32), radii.astype(np.float32))


@cache
def _of_markers(sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Return (M, N) weights of a marker's mean motion, (2, M, N) of its stretch in x and y."""
    spec = get_sensor(sensor)
    assert spec.points is not None
    owner = cKDTree(spec.layout_mm).query(spec.points.place_mm)[1]
    mean = (owner == np.arange(len(spec.layout_mm))[:, None]).astype(np.float64)
    mean /= mean.sum(axis=1, keepdims=True)
    # (2, M, N)
    aside = (spec.points.place_mm - (mean @ spec.points.place_mm)[owner]).T[:, None] * (mean > 0)
    spread = (aside**2).sum(axis=-1, keepdims=True)
    return mean, np.divide(aside, spread, where=spread > 0, out=np.zeros_like(aside))
