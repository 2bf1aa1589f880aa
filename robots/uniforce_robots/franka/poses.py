"""Between the project's five axes and the hand's pose: x, y, z m, yaw rad, width m in the robot's base frame.

At yaw 0 the fingers close along the base's x axis and the tool points down, as in the simulated scene. The scene's tool
frame closes along x, the Franka Hand along y: a quarter turn about z lies between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TOOL_DOWN = np.diag([1.0, -1.0, -1.0])  # tool frame in the base frame at yaw 0
TOOL_TO_EE = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # tool x is the hand's y


@dataclass(frozen=True)
class ToolPose:
    """Where the tool is or shall be: ``position_m`` (3,) in the base frame, ``yaw_rad`` about the base's z."""

    position_m: np.ndarray
    yaw_rad: float

    def ee_to_base(self) -> np.ndarray:
        """(4, 4) pose of the hand, pointing straight down."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        pose = np.eye(4)
        pose[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ TOOL_DOWN @ TOOL_TO_EE.T
        pose[:3, 3] = self.position_m
        return pose

    @classmethod
    def from_ee(cls, ee_to_base: np.ndarray) -> ToolPose:
        """Read the pose of a hand; a tilt, which no policy knows of, is dropped."""
        tool = ee_to_base[:3, :3] @ TOOL_TO_EE
        return cls(ee_to_base[:3, 3].copy(), float(np.arctan2(tool[1, 0], tool[0, 0])))


def shortest_turn(from_rad: float, to_rad: float) -> float:
    """Return the turn in (−π, π] that leads from one angle to another."""
    return float(np.pi - (np.pi - (to_rad - from_rad)) % (2 * np.pi))


def between(start: ToolPose, end: ToolPose, share: float) -> ToolPose:
    """Return the pose a share in [0, 1] of the way along, turning the shorter way."""
    position = start.position_m + share * (end.position_m - start.position_m)
    return ToolPose(position, start.yaw_rad + share * shortest_turn(start.yaw_rad, end.yaw_rad))
