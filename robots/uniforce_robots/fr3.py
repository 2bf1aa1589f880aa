"""The Franka Research 3: published Denavit–Hartenberg table, joint limits and kinematics.

Source: Franka documentation, "Robot and interface specifications" (Craig's modified convention).
Imports numpy alone, so that the stand-in starts without torch.
"""

from dataclasses import dataclass

import numpy as np

JOINTS = 7
# a m, d m, alpha rad of each joint's frame in the one before
DH = np.array(
    [
        (0.0, 0.333, 0.0),
        (0.0, 0.0, -np.pi / 2),
        (0.0, 0.316, np.pi / 2),
        (0.0825, 0.0, np.pi / 2),
        (-0.0825, 0.384, -np.pi / 2),
        (0.0, 0.0, np.pi / 2),
        (0.088, 0.0, np.pi / 2),
    ]
)
FLANGE_m = 0.107  # joint 7 to flange
Q_MIN_rad = np.array([-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.5409, -3.0196])
Q_MAX_rad = np.array([2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196])
DQ_MAX_rad_s = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
TAU_MAX_Nm = np.array([87.0, 87, 87, 87, 12, 12, 12])
HOME_q_rad = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])


def rotation_z(angle_rad: float) -> np.ndarray:
    """Return (4, 4) rotation about z."""
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def _fixed(a: float, d: float, alpha: float) -> np.ndarray:
    """Return (4, 4) of a row of ``DH`` at joint angle 0."""
    c = np.cos(alpha)
    s = np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -s, -d * s], [0, s, c, d * c], [0, 0, 0, 1]])


# The hand is mounted at −45°; its tool point lies 103.4 mm below the flange (Franka Hand manual).
HAND_TO_FLANGE = _fixed(0, 0.1034, 0) @ rotation_z(-np.pi / 4)
_FIXED = np.array([_fixed(*row) for row in DH])
_FLANGE = _fixed(0, FLANGE_m, 0)


@dataclass(frozen=True)
class Posture:
    """Where the arm is, in the base frame."""

    flange_to_base: np.ndarray  # (4, 4), m
    axes: np.ndarray  # (7, 3) of the joints
    origins_m: np.ndarray  # (7, 3) of the joints

    def jacobian(self, point_m: np.ndarray) -> np.ndarray:
        """Return (6, 7): joint speeds → linear and angular velocity of a point, base frame."""
        return np.hstack([np.cross(self.axes, point_m - self.origins_m), self.axes]).T


def posture(q_rad: np.ndarray) -> Posture:
    """Return the arm's posture at joint angles (7,)."""
    c = np.cos(q_rad)[:, None]
    s = np.sin(q_rad)[:, None]
    local = _FIXED.copy()
    local[:, :, 0] = _FIXED[:, :, 0] * c + _FIXED[:, :, 1] * s
    local[:, :, 1] = _FIXED[:, :, 1] * c - _FIXED[:, :, 0] * s
    frames = np.empty((JOINTS, 4, 4))
    T = np.eye(4)
    for i in range(JOINTS):
        T = T @ local[i]
        frames[i] = T
    return Posture(T @ _FLANGE, frames[:, :3, 2], frames[:, :3, 3])
