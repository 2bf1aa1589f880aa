"""The monitor's operators: a fault, its five doses from mild to severe, and the dose without it.

Ids of RoboTactile's suite where the fault is the same; further ones in the same manner
(docs/stress.md).
"""

from dataclasses import dataclass

from uniforce_vtla.contact.faults import FAULTS
from uniforce_vtla.contact.worn_in_words import wear


@dataclass(frozen=True)
class Operator:
    """A fault of ``uniforce_vtla.contact.faults`` under an id, with its doses."""

    fault: str
    doses: tuple[float, ...]
    benign: float  # the same code path, and nothing changes

    @property
    def unit(self) -> str:
        """Unit of a dose."""
        return FAULTS[self.fault].unit

    def words(self, dose: float) -> str:
        """Return what stands behind a sensor's name."""
        return f"+{self.fault}={dose:g}"


OPERATORS = {
    "G1 stiffer": Operator("stiffness", (1.1, 1.2, 1.3, 1.45, 1.6), 1.0),
    "G1 softer": Operator("stiffness", (0.9, 0.8, 0.7, 0.55, 0.4), 1.0),
    "G2 keener": Operator("gain", (1.1, 1.2, 1.3, 1.45, 1.6), 1.0),
    "G2 duller": Operator("gain", (0.9, 0.8, 0.7, 0.55, 0.4), 1.0),
    "C2 shift": Operator("shift", (0.25, 0.5, 1.0, 1.5, 2.0), 0.0),
    "C3 turn": Operator("turn", (2.0, 4.0, 8.0, 12.0, 16.0), 0.0),
    "M1 markers lost": Operator("lost", (0.05, 0.1, 0.2, 0.3, 0.4), 0.0),
    "M2 flicker": Operator("flicker", (0.05, 0.1, 0.2, 0.3, 0.4), 0.02),
    "F4 dead patch": Operator("dead", (0.06, 0.12, 0.19, 0.25, 0.5), 0.0),
    "D3 crosstalk": Operator("crosstalk", (0.05, 0.1, 0.2, 0.3, 0.5), 0.0),
    "L1 darker": Operator("light", (0.8, 0.65, 0.5, 0.35, 0.2), 1.0),
    "L1 brighter": Operator("light", (1.1, 1.25, 1.5, 1.75, 2.0), 1.0),
    "R1 stale reference": Operator("stale", (0.25, 0.5, 1.0, 2.0, 4.0), 0.0),
    "H1 creep": Operator("creep", (0.1, 0.2, 0.3, 0.45, 0.6), 0.0),
    "T1 lag": Operator("lag", (33, 67, 133, 267, 533), 0.0),
    "T2 stall": Operator("stall", (67, 133, 300, 600, 1200), 0.0),
}


def worn_with(operator: Operator, sensor: str, dose: float) -> str | None:
    """Return a sensor's words with the fault; None where this kind can't have it."""
    signal = wear(sensor)(0).sensor.spec.signal
    return sensor + operator.words(dose) if signal in FAULTS[operator.fault].signals else None
