"""Check that a sensor is the one named, when a finger connects.

Marker counts differ by a third between units of one type (real GelSights show 64 to 108), so the
count is only held to half and double. The outline tells a dome from a flat gel. The outermost
marker lies 1.34 median radii from the middle of a disc, and 1.56 to 1.70 of a rectangle.
"""

import numpy as np

from uniforce_vtla.errors import expected
from uniforce_vtla.sensors import SensorSpec

OUTLINE_TOLERANCE = 0.13  # between a disc's 1.34 and a rectangle's smallest 1.56 lies 0.22
OUTERMOST = 98  # percentile of the radius: one stray blob is no outline
COUNT_RATIO = 2.0


def outline(points: np.ndarray) -> float:
    """Return how far the outermost of (M, 2) points lie from their middle, in median radii."""
    radii = np.linalg.norm(points - points.mean(axis=0), axis=1)
    return float(np.percentile(radii, OUTERMOST) / np.median(radii))


def why_not(spec: SensorSpec, centres_px: np.ndarray, name: str) -> str | None:
    """Return why (M, 2) marker centres can't be those of a sensor, None where they can.

    Args:
        spec: of the camera sensor it is said to be.
        centres_px: in free air, or nearly.
        name: how the message calls it.
    """
    layout_px = spec.layout_mm * np.asarray(spec.px_per_mm)
    wanted = outline(layout_px)
    came = outline(centres_px)
    count = len(layout_px)
    found = len(centres_px)
    if (
        abs(wanted - came) <= OUTLINE_TOLERANCE
        and count / COUNT_RATIO <= found <= count * COUNT_RATIO
    ):
        return None
    looks = f"about {count} markers of outline {wanted:.2f} (1.34 a disc, 1.6 a rectangle)"
    do = (
        "Another sensor answers: check cable and config. "
        "A unit that does look so: check_identity=false."
    )
    return expected(name, looks, f"{found} of {came:.2f}", do)
