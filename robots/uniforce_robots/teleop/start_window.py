"""How near a device that gives poses, or a file, must be to the robot before an episode may start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_robots.franka.poses import shortest_turn
from uniforce_vtla.errors import TeleoperatorError, expected


@dataclass(frozen=True)
class StartWindow:
    """How far a device may stand from the robot at the start; the target then closes the gap at its limits."""

    position_m: float = 0.05
    yaw_rad: float = 0.3
    width_m: float = 0.03

    def check(self, measured: np.ndarray, device: np.ndarray, what: str) -> None:
        """Compare the robot's axes (5,) with the device's (5,).

        Raises:
            TeleoperatorError: ``far``.
        """
        turn = abs(shortest_turn(float(measured[3]), float(device[3])))
        gaps = (float(np.linalg.norm(device[:3] - measured[:3])), turn, abs(float(device[4] - measured[4])))
        limits = (self.position_m, self.yaw_rad, self.width_m)
        if any(gap > limit for gap, limit in zip(gaps, limits, strict=True)):
            wanted = "within {:.3f} m, {:.2f} rad, {:.3f} m of width of the robot".format(*limits)
            came = "{:.3f} m, {:.2f} rad, {:.3f} m away".format(*gaps)
            raise TeleoperatorError(expected(what, wanted, came, "Bring them together, then start."), "far")
