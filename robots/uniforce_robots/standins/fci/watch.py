"""When the simulated arm really moved and when a client really spoke, in the robot's own milliseconds."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from uniforce_robots.standins.fci.arm import Arm
from uniforce_robots.standins.fci.kinematics import JOINTS

MOVING_m_s, MOVING_rad_s = 0.002, 0.02  # of the tool; below both the arm is at rest
TORQUE_CHANGE_Nm = 0.1  # smaller ones are a steady push


@dataclass
class Watch:
    """Last times something happened; None: never.

    Attributes:
        last_moving_ms: the tool was faster than 2 mm/s or 0.02 rad/s.
        last_moving_s: the same, CLOCK_MONOTONIC: a robot that waits for its client has the slower clock.
        last_command_ms: a command of the control loop arrived.
        last_torque_change_ms: the torque on the joints was another than before by more than 0.1 Nm.
    """

    last_moving_ms: int | None = None
    last_moving_s: float | None = None
    last_command_ms: int | None = None
    last_torque_change_ms: int | None = None
    _tau_Nm: np.ndarray = field(default_factory=lambda: np.zeros(JOINTS))

    def look(self, arm: Arm, now_ms: int) -> None:
        """Look at the arm at the end of a millisecond."""
        twist = arm.twist
        if twist[:3] @ twist[:3] > MOVING_m_s**2 or twist[3:] @ twist[3:] > MOVING_rad_s**2:
            self.last_moving_ms, self.last_moving_s = now_ms, time.monotonic()
        if arm.tau_Nm is not self._tau_Nm and np.abs(arm.tau_Nm - self._tau_Nm).max() > TORQUE_CHANGE_Nm:
            self.last_torque_change_ms, self._tau_Nm = now_ms, arm.tau_Nm

    def describe(self, now_ms: int) -> dict[str, float | None]:
        """Return the times, and since when the arm is at rest (None while it moves)."""
        last = self.last_moving_ms
        return {
            "last_moving_ms": last,
            "last_moving_s": self.last_moving_s,
            "last_command_ms": self.last_command_ms,
            "last_torque_change_ms": self.last_torque_change_ms,
            "held_since_ms": 0 if last is None else last + 1 if last < now_ms else None,
        }
