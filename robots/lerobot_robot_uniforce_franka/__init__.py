"""Franka Research 3 with its hand as a LeRobot robot, ``uniforce_franka``. Never run on hardware."""

from lerobot_robot_uniforce_franka.config import UniforceFrankaConfig
from lerobot_robot_uniforce_franka.robot import UniforceFranka

__all__ = ["UniforceFranka", "UniforceFrankaConfig"]
