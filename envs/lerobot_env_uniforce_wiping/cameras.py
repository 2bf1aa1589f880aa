"""The two scene cameras: pinhole poses, with this episode's jitter."""

from dataclasses import dataclass

import mujoco
import numpy as np

from lerobot_env_uniforce_wiping.levels import CAMERA_PX
from lerobot_env_uniforce_wiping.mjcf import TCP_m
from lerobot_env_uniforce_wiping.scene_params import SceneParams
from uniforce_vtla.keys import CAMERAS

FOV_rad = {"front": 0.54, "wrist": 1.35}
# robot base frame
FRONT_m = np.array([1.15, -0.05, 0.44])
FRONT_LOOK_m = np.array([0.47, -0.045, 0.045])
# hand frame
WRIST_m = np.array([0.0, -0.095, 0.045])
WRIST_LOOK_m = np.array([0.0, -0.035, TCP_m + 0.045])


@dataclass(frozen=True)
class Camera:
    """A pinhole camera; rows of ``rotation`` are its right, down and forward axes, world frame."""

    position_m: np.ndarray
    rotation: np.ndarray
    focal_px: float

    def to_camera(self, points_m: np.ndarray) -> np.ndarray:
        """Return (N, 3) right, down, forward of world points."""
        return (points_m - self.position_m) @ self.rotation.T

    def to_pixels(self, local_m: np.ndarray) -> np.ndarray:
        """Return (..., 2) pixels x, y of camera-frame points (..., 3) in front of the camera."""
        return local_m[..., :2] / local_m[..., 2:] * self.focal_px + CAMERA_PX / 2


def look_at(position_m: np.ndarray, target_m: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return (3, 3) rows right, down, forward."""
    forward = (target_m - position_m) / np.linalg.norm(target_m - position_m)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def rotation(turn_rad: tuple[float, ...]) -> np.ndarray:
    """Return (3, 3) rotation of a rotation vector."""
    quaternion = np.zeros(4)
    matrix = np.zeros(9)
    angle = float(np.linalg.norm(turn_rad))
    mujoco.mju_axisAngle2Quat(quaternion, np.array(turn_rad) / max(angle, 1e-12), angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _mounted(
    scene: SceneParams, index: int, position_m: np.ndarray, look_m: np.ndarray, up_z: float
) -> Camera:
    shift = np.array(scene.camera_shift_m[index])
    pointing = look_at(position_m + shift, look_m + shift, np.array([0.0, 0.0, up_z]))
    focal = CAMERA_PX / 2 / float(np.tan(FOV_rad[CAMERAS[index]] / 2))
    return Camera(position_m + shift, rotation(scene.camera_turn_rad[index]) @ pointing, focal)


def front_camera(scene: SceneParams) -> Camera:
    """Return the camera before the robot, which sees it over the board; world frame."""
    return _mounted(scene, 0, FRONT_m, FRONT_LOOK_m, 1.0)


def wrist_camera(scene: SceneParams) -> Camera:
    """Return the camera on the hand, which sees fingers, eraser and board; hand frame."""
    return _mounted(scene, 1, WRIST_m, WRIST_LOOK_m, -1.0)


def carried(camera: Camera, body_m: np.ndarray, body_axes: np.ndarray) -> Camera:
    """Return a camera given in a body's frame in the world frame, for the body's pose."""
    return Camera(
        body_m + body_axes @ camera.position_m, camera.rotation @ body_axes.T, camera.focal_px
    )
