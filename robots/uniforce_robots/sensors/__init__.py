"""Tactile fingers, and scene cameras read like them, as LeRobot cameras.

Importing this package registers ``uniforce_tactile``, ``uniforce_uskin`` and ``uniforce_scene``.

device → ``SampleReader`` (thread, newest stamped samples)
→ ``TactileFinger`` (reference, marker image) → robot.
"""

from uniforce_robots.sensors.config_uniforce import (
    UniforceSceneCameraConfig,
    UniforceTactileCameraConfig,
    UniforceUskinConfig,
)
from uniforce_robots.sensors.finger import UniforceSceneCamera, UniforceTactileCamera, UniforceUskin

__all__ = [
    "UniforceSceneCamera",
    "UniforceSceneCameraConfig",
    "UniforceTactileCamera",
    "UniforceTactileCameraConfig",
    "UniforceUskin",
    "UniforceUskinConfig",
]
