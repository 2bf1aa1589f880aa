"""The two scene cameras: pinhole poses, with this episode's jitter."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.mjcf import TCP_m
from lerobot_env_uniforce_wiping.scene_params import SceneParams

CAMERA_PX = 224
FOV_rad = {"front": 0.52, "wrist": 1.35}
FRONT_m, FRONT_LOOK_m = np.array([1.05, -0.03, 0.52]), np.array([0.47, -0.04, 0.03])  # robot base frame
WRIST_m, WRIST_LOOK_m = np.array([0.0, -0.095, 0.045]), np.array([0.0, -0.035, TCP_m + 0.045])  # hand frame


@dataclass(frozen=True)
class Camera:
    """A pinhole: ``rotation`` has the camera's right, down and forward axes as rows, world frame."""

    position_m: np.ndarray
    rotation: np.ndarray
    focal_px: float

    def to_camera(self, points_m: np.ndarray) -> np.ndarray:
        """Return (N, 3) right, down, forward of world points."""
        return (points_m - self.position_m) @ self.rotation.T

    def to_pixels(self, local_m: np.ndarray) -> np.ndarray:
        """Return (N, 2) pixels x, y of camera-frame points in front of the camera."""
        return local_m[:, :2] / local_m[:, 2:] * self.focal_px + CAMERA_PX / 2


def look_at(position_m: np.ndarray, target_m: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return (3, 3) rows right, down, forward."""
    forward = (target_m - position_m) / np.linalg.norm(target_m - position_m)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _turned(rotation: np.ndarray, turn_rad: tuple[float, ...]) -> np.ndarray:
    x, y, z = turn_rad
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn, _ = np.linalg.qr(np.eye(3) + skew)  # jitter is small: near enough a rotation vector
    return turn * np.sign(np.diag(turn @ np.eye(3))) @ rotation if np.any(skew) else rotation


def _focal(name: str) -> float:
    return CAMERA_PX / 2 / float(np.tan(FOV_rad[name] / 2))


def front_camera(scene: SceneParams) -> Camera:
    """Stands before the robot and looks back at it over the board."""
    position = FRONT_m + np.array(scene.camera_shift_m[0])
    rotation = look_at(position, FRONT_LOOK_m + np.array(scene.camera_shift_m[0]), np.array([0.0, 0.0, 1.0]))
    return Camera(position, _turned(rotation, scene.camera_turn_rad[0]), _focal("front"))


def wrist_camera(scene: SceneParams, data: mujoco.MjData) -> Camera:
    """Rides on the hand and looks past the fingers at the eraser and the board."""
    hand = data.body("hand")
    axes = hand.xmat.reshape(3, 3)
    shift = np.array(scene.camera_shift_m[1])
    rotation = look_at(WRIST_m + shift, WRIST_LOOK_m + shift, np.array([0.0, 0.0, -1.0]))
    local = _turned(rotation, scene.camera_turn_rad[1])
    return Camera(hand.xpos + axes @ (WRIST_m + shift), local @ axes.T, _focal("wrist"))
