"""Faults of the curves: of the sensor, behind its words, or of the scene."""

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.stress.disturbed import Disturbance, late, pushed, rougher

NOTHING = Disturbance()


@dataclass(frozen=True)
class Fault:
    """A fault in four doses around its cliff."""

    axis: str  # what a dose is, with its unit
    none: float  # dose that changes nothing
    doses: tuple[float, ...]
    sensor: str = ""  # fault of ``uniforce_vtla.contact.faults``; "" = the scene's
    scene: Callable[[float], Disturbance] = lambda dose: NOTHING

    def words(self, dose: float) -> str:
        """Return what stands behind a sensor's name."""
        return f"+{self.sensor}={dose:g}" if self.sensor else ""


FAULTS = {
    "sensitivity": Fault("markers move × for the same force", 1, (0.7, 0.85, 1.15, 1.3), "gain"),
    "stiffness": Fault("pad × as stiff", 1, (0.7, 0.85, 1.2, 1.4), "stiffness"),
    "late pictures": Fault("pictures late, ms", 0, (33, 67, 133, 267), "lag"),
    "late actions": Fault("actions late, ms", 0, (33, 67, 133, 267), scene=late),
    "pushed arm": Fault("push every 2 s, N", 0, (2, 4, 6, 8), scene=pushed),
    "rough board": Fault("board × as rough", 1, (1.25, 1.5, 1.75, 2), scene=rougher),
}
SCALES = ("sensitivity", "stiffness")  # that a weighing mends
