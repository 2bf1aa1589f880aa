"""A grasp as it grows: each frame's fields and forces are read once, its pairs can be judged at any time."""

from __future__ import annotations

import numpy as np

from uniforce_robots.pairs.finger_force import FingerForce
from uniforce_robots.pairs.gate import MotionLimits, quasi_static
from uniforce_robots.pairs.pair_judge import GraspSignals
from uniforce_robots.pairs.rig import PairRig, RigFrame
from uniforce_robots.pairs.touch_field import TouchField
from uniforce_vtla.contracts import FINGERS, Finger


class FingerReaders:
    """Both fingers of a session: marker image → touch field and force.

    Args:
        rig: whose sensors they are.
        references: (480, 640) free-air images by finger.
    """

    def __init__(self, rig: PairRig, references: dict[Finger, np.ndarray]) -> None:
        self._fields = {f: TouchField(references[f], f) for f in FINGERS}
        self._forces = {f: FingerForce.from_pretrained(rig.sensors[f]) for f in FINGERS}

    def __call__(self, finger: Finger, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (192,) field and (3,) N, canonical frame."""
        field = self._fields[finger](image)
        return field, self._forces[finger].read(field[None])[0]


class GraspTrack:
    """Frames of one grasp with what was read off them; images stay, since the good ones are kept.

    Attributes:
        frames: so far.
        fields, forces: of each frame by finger, (192,) and (3,) N, canonical.
    """

    def __init__(self, mass_kg: float, readers: FingerReaders) -> None:
        self._mass_kg, self._readers = mass_kg, readers
        self.frames: list[RigFrame] = []
        self.fields: dict[Finger, list[np.ndarray]] = {f: [] for f in FINGERS}
        self.forces: dict[Finger, list[np.ndarray]] = {f: [] for f in FINGERS}

    def add(self, frame: RigFrame) -> None:
        """Read a frame and keep it."""
        self.frames.append(frame)
        for finger in FINGERS:
            field, force = self._readers(finger, frame.images[finger])
            self.fields[finger].append(field)
            self.forces[finger].append(force)

    def signals(self) -> GraspSignals:
        """Return what the judge wants to know."""
        return GraspSignals(
            np.array(self.forces["left"]),
            np.array(self.forces["right"]),
            np.array([frame.velocity_m_s for frame in self.frames]),
            np.array([frame.acceleration_m_s2 for frame in self.frames]),
            self._mass_kg,
        )

    def gate(self, rate_hz: float, limits: MotionLimits) -> np.ndarray:
        """Return why each frame isn't quasi-static, see ``quasi_static``; the firmer finger says what is touched."""
        signals = self.signals()
        contact_N = np.maximum(signals.left_N[:, 2], signals.right_N[:, 2])
        return quasi_static(signals.velocity_m_s, signals.acceleration_m_s2, contact_N, rate_hz, limits)
