"""A grasp as it grows: each frame is read once; the grasp can be judged at any time.

The gate is quasi-static: a frame counts only while the hand is slow, and has been for a moment.
Forces of both fingers are equal only where nothing is accelerated. A fast hand also smears a
camera's markers, and the two sensors' delays differ, so speed is limited beside acceleration.
"""

from dataclasses import dataclass

import numpy as np

from uniforce_robots.pairs.finger_force import FingerForce, TouchField
from uniforce_robots.pairs.pair_judge import GraspSignals
from uniforce_robots.pairs.rig import PairRig, RigFrame
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, expected


@dataclass(frozen=True)
class MotionLimits:
    """Limits of slow motion."""

    speed_m_s: float = 0.15  # of the hand; at 30 Hz 0.15 m/s is 5 mm between two frames
    acceleration_m_s2: float = 1.0  # of the hand; 0.3 kg × 1 m/s² is 0.3 N, a tenth of a light grip
    # how long it must have been slow: the rubber needs some time to come to rest
    settle_s: float = 0.1
    grip_N: float = 0.8  # a lighter grip says nothing of equilibrium

    def __post_init__(self) -> None:
        if min(self.speed_m_s, self.acceleration_m_s2) <= 0 or min(self.settle_s, self.grip_N) < 0:
            raise ContractError(expected("motion limits", "positive", self, "Check the config."))


def quasi_static(
    velocity_m_s: np.ndarray,
    acceleration_m_s2: np.ndarray,
    contact_N: np.ndarray,
    rate_hz: float,
    limits: MotionLimits,
) -> np.ndarray:
    """Return (T,) "fast", "jerked", "settling", "no contact", or "" where a frame counts.

    Causal, so that it can be asked anew as frames come. Velocity and acceleration (T, 3) are the
    hand's, ``contact_N`` (T,) is the stronger finger's estimated normal force.
    """
    fast = np.linalg.norm(velocity_m_s, axis=1) > limits.speed_m_s
    jerked = np.linalg.norm(acceleration_m_s2, axis=1) > limits.acceleration_m_s2
    index = np.arange(len(fast))
    # frame that was last not slow
    last = np.maximum.accumulate(np.where(fast | jerked, index, -(10**9)))
    settling = index - last <= round(limits.settle_s * rate_hz)
    names = ["fast", "jerked", "settling", "no contact"]
    return np.select([fast, jerked, settling, contact_N < limits.grip_N], names, default="")


class FingerReaders:
    """Both fingers of a session: marker image → force, with their (480, 640) free-air images."""

    def __init__(self, rig: PairRig, references: dict[Finger, np.ndarray]) -> None:
        self._fields = {f: TouchField(references[f], f) for f in FINGERS}
        self._forces = {f: FingerForce.from_pretrained(rig.sensors[f]) for f in FINGERS}

    def __call__(self, finger: Finger, image: np.ndarray) -> np.ndarray:
        """Return (3,) N, canonical frame."""
        return self._forces[finger].read(self._fields[finger](image)[None])[0]


class GraspTrack:
    """Frames of one grasp with their forces, (3,) N by finger, canonical; images stay."""

    def __init__(self, mass_kg: float, readers: FingerReaders) -> None:
        self._mass_kg = mass_kg
        self._readers = readers
        self.frames: list[RigFrame] = []
        self.forces: dict[Finger, list[np.ndarray]] = {f: [] for f in FINGERS}

    def add(self, frame: RigFrame) -> None:
        """Read a frame and keep it."""
        self.frames.append(frame)
        for finger in FINGERS:
            self.forces[finger].append(self._readers(finger, frame.images[finger]))

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
        """Return why each frame isn't quasi-static, by the firmer finger; see ``quasi_static``."""
        signals = self.signals()
        contact_N = np.maximum(signals.left_N[:, 2], signals.right_N[:, 2])
        return quasi_static(
            signals.velocity_m_s, signals.acceleration_m_s2, contact_N, rate_hz, limits
        )
