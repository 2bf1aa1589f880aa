"""Quasi-static gate: a frame counts only while the hand is slow, and has been for a moment.

Forces of both fingers are equal only where nothing is accelerated. A fast hand also smears a camera's markers and takes
the two sensors' different delays apart, so speed is limited beside acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import ContractError, expected


@dataclass(frozen=True)
class MotionLimits:
    """What still counts as slow.

    Attributes:
        speed_m_s: of the hand; at 30 Hz 0.15 m/s is 5 mm between two frames.
        acceleration_m_s2: of the hand; 0.3 kg × 1 m/s² is 0.3 N, a tenth of a light grip.
        settle_s: how long it must have been slow: the rubber needs some time to come to rest.
        grip_N: a lighter grip says nothing of equilibrium.
    """

    speed_m_s: float = 0.15
    acceleration_m_s2: float = 1.0
    settle_s: float = 0.1
    grip_N: float = 0.8

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
    """Return why each of T frames doesn't count: (T,) of "fast", "jerked", "settling", "no contact"; "" where it does.

    Causal, so that it can be asked anew as frames come.

    Args:
        velocity_m_s: (T, 3) of the hand.
        acceleration_m_s2: (T, 3) of the hand.
        contact_N: (T,) the stronger finger's normal force, estimated.
        rate_hz: of the frames.
        limits: what counts as slow.
    """
    fast = np.linalg.norm(velocity_m_s, axis=1) > limits.speed_m_s
    jerked = np.linalg.norm(acceleration_m_s2, axis=1) > limits.acceleration_m_s2
    light = contact_N < limits.grip_N
    settle = round(limits.settle_s * rate_hz)
    since = _frames_since(fast | jerked)
    names = ["fast", "jerked", "settling", "no contact"]
    return np.select([fast, jerked, since <= settle, light], names, default="")


def _frames_since(event: np.ndarray) -> np.ndarray:
    """(T,) frames since the last event; very many before the first."""
    index = np.arange(len(event))
    last = np.maximum.accumulate(np.where(event, index, -(10**9)))
    return index - last
