"""Tactile fingers, and scene cameras read like them, as LeRobot cameras.

Importing this package registers ``uniforce_tactile``, ``uniforce_uskin`` and ``uniforce_scene``.

device → ``SampleReader`` (thread, ring of stamped samples) → ``TactileFinger`` (reference, marker image) → robot.
"""

from lerobot_camera_uniforce.config_uniforce import (
    UniforceSceneCameraConfig,
    UniforceTactileCameraConfig,
    UniforceUskinConfig,
)
from lerobot_camera_uniforce.scene_camera import UniforceSceneCamera
from lerobot_camera_uniforce.tactile_camera import UniforceTactileCamera
from lerobot_camera_uniforce.uskin_camera import UniforceUskin

__all__ = [
    "UniforceSceneCamera",
    "UniforceSceneCameraConfig",
    "UniforceTactileCamera",
    "UniforceTactileCameraConfig",
    "UniforceUskin",
    "UniforceUskinConfig",
]
