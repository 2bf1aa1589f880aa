"""What a pair recorder needs of a rig, real or simulated: frames of both fingers with the hand's motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uniforce_vtla.contracts import Finger

CLOSING = 0  # index of the closing axis in the hand's velocities and accelerations


@dataclass(frozen=True)
class RigFrame:
    """One moment.

    Attributes:
        grasp: counts grasps; a new number means the fingers had opened between.
        images: finger → (480, 640) uint8 marker image, as the sensor saw it.
        velocity_m_s, acceleration_m_s2: (3,) of the hand in its own frame, x = the fingers' closing axis.
        grip_N: the gripper's own estimate of its force.
    """

    grasp: int
    images: dict[Finger, np.ndarray]
    velocity_m_s: np.ndarray
    acceleration_m_s2: np.ndarray
    grip_N: float


class PairRig(Protocol):
    """A hand with two tactile fingers.

    Attributes:
        sensors: finger → registry name.
        rate_hz: frames per second.
        mass_kg: of the held object with what moves of its holder, as weighed.
    """

    sensors: dict[Finger, str]
    rate_hz: float
    mass_kg: float

    def references(self) -> dict[Finger, np.ndarray]:
        """Return the session's free-air references (480, 640)."""
        ...

    def frames(self, indenter: str) -> Iterator[RigFrame]:
        """Yield frames for as long as one asks, of grasps of one indenter."""
        ...
