"""Between the five axes (x, y, z m, yaw rad, width m, base frame) and the hand's pose.

At yaw 0 the fingers close along the base's x axis and the tool points down, as in the simulated
scene. The scene's tool frame closes along x, the Franka Hand along y: a quarter turn about z apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from uniforce_vtla.keys import AXES

TOOL_DOWN = np.diag([1.0, -1.0, -1.0])  # tool frame in the base frame at yaw 0
STRAIGHT = 1e-9
TOOL_TO_EE = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # tool x is the hand's y


@dataclass(frozen=True)
class ToolPose:
    """Pose of the tool: ``position_m`` (3,) in the base frame, ``yaw_rad`` about the base's z.

    ``tilt_rad`` (3,) is the rotation vector from straight down to the hand's direction, base frame.
    No action names it: it is measured, bounded, and levelled only along a wished motion.
    """

    position_m: np.ndarray
    yaw_rad: float
    tilt_rad: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def ee_to_base(self) -> np.ndarray:
        """Return (4, 4) pose of the hand."""
        turn = Rotation.from_rotvec(self.tilt_rad) * Rotation.from_euler("z", self.yaw_rad)
        pose = np.eye(4)
        pose[:3, :3] = turn.as_matrix() @ TOOL_DOWN @ TOOL_TO_EE.T
        pose[:3, 3] = self.position_m
        return pose

    @classmethod
    def from_ee(cls, ee_to_base: np.ndarray) -> ToolPose:
        """Read the pose of a hand."""
        rotation = ee_to_base[:3, :3]
        tool = rotation @ TOOL_TO_EE
        # the turn about z that is left of rotation = tilt · turn, in closed form
        yaw_rad = float(np.arctan2(tool[1, 0] + tool[0, 1], tool[0, 0] - tool[1, 1]))
        return cls(ee_to_base[:3, 3].copy(), yaw_rad, _tilt(rotation))


def _tilt(rotation: np.ndarray) -> np.ndarray:
    """Return the shortest rotation (3,) from straight down to the hand's z axis."""
    points_x, points_y, points_z = rotation[:, 2]
    axis = np.array([points_y, -points_x, 0.0])  # down × pointing; its length is the angle's sine
    sine = float(np.hypot(points_x, points_y))
    angle_rad = float(np.arctan2(sine, -points_z))
    if sine < STRAIGHT:  # straight down, or straight up, where any level axis will do
        return np.array([angle_rad, 0.0, 0.0])
    return axis * angle_rad / sine


def by_axis(axes: np.ndarray) -> dict[str, float]:
    """Return (5,) numbers by ``keys.AXES``, as LeRobot hands them on."""
    return dict(zip(AXES, axes.tolist(), strict=True))


def shortest_turn(from_rad: float, to_rad: float) -> float:
    """Return the turn in (−π, π] that leads from one angle to another."""
    return float(np.pi - (np.pi - (to_rad - from_rad)) % (2 * np.pi))


def between(start: ToolPose, end: ToolPose, share: float) -> ToolPose:
    """Return the pose a share in [0, 1] of the way along, turned the shorter way, start's tilt."""
    position = start.position_m + share * (end.position_m - start.position_m)
    yaw_rad = start.yaw_rad + share * shortest_turn(start.yaw_rad, end.yaw_rad)
    return replace(start, position_m=position, yaw_rad=yaw_rad)
