"""Tactile fingers, and scene cameras read like them, as LeRobot cameras.

Importing this package registers ``uniforce_tactile``, ``uniforce_uskin`` and ``uniforce_scene``.

device → ``SampleReader`` (thread, newest stamped samples) → ``TactileFinger`` (reference, marker image) → robot.
"""

from uniforce_robots.sensors.config_uniforce import (
    UniforceSceneCameraConfig,
    UniforceTactileCameraConfig,
    UniforceUskinConfig,
)
from uniforce_robots.sensors.finger import UniforceTactileCamera, UniforceUskin
from uniforce_robots.sensors.sampled_camera import UniforceSceneCamera

__all__ = [
    "UniforceSceneCamera",
    "UniforceSceneCameraConfig",
    "UniforceTactileCamera",
    "UniforceTactileCameraConfig",
    "UniforceUskin",
    "UniforceUskinConfig",
]
