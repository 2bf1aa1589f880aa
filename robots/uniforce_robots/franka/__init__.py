"""Franka Research 3 with its hand as LeRobot robot ``uniforce_franka``. Never run on hardware."""

from uniforce_robots.franka.config import UniforceFrankaConfig
from uniforce_robots.franka.robot import UniforceFranka

__all__ = ["UniforceFranka", "UniforceFrankaConfig"]
