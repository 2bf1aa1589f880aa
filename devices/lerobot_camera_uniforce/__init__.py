"""Tactile fingers as LeRobot cameras.  Importing this package registers ``uniforce_tactile`` and ``uniforce_uskin``.

device → ``SampleReader`` (thread, ring of stamped samples) → ``TactileFinger`` (reference, marker image) → robot.
"""

from lerobot_camera_uniforce.config_uniforce import UniforceTactileCameraConfig, UniforceUskinConfig
from lerobot_camera_uniforce.tactile_camera import UniforceTactileCamera
from lerobot_camera_uniforce.uskin_camera import UniforceUskin

__all__ = ["UniforceTactileCamera", "UniforceTactileCameraConfig", "UniforceUskin", "UniforceUskinConfig"]
