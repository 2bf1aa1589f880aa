"""Arm and hand of the configured client."""

from __future__ import annotations

from lerobot_robot_uniforce_franka.arm import Arm
from lerobot_robot_uniforce_franka.config import UniforceFrankaConfig
from lerobot_robot_uniforce_franka.franky_arm import FrankyArm
from lerobot_robot_uniforce_franka.franky_hand import FrankyHand
from lerobot_robot_uniforce_franka.hand import HandDriver
from lerobot_robot_uniforce_franka.pylibfranka_arm import PylibfrankaArm
from lerobot_robot_uniforce_franka.pylibfranka_hand import PylibfrankaHand


def make_backend(config: UniforceFrankaConfig) -> tuple[Arm, HandDriver]:
    """Return the arm and hand of the configured backend, not yet connected."""
    if config.backend == "pylibfranka":
        return PylibfrankaArm(config.arm_settings), PylibfrankaHand(config.address, config.connect_deadline_s)
    return FrankyArm(config.arm_settings, has_hand=True), FrankyHand(config.address)
