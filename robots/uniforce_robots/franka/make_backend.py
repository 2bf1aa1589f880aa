"""Arm and hand of the configured client."""

from __future__ import annotations

from uniforce_robots.franka.arm import Arm
from uniforce_robots.franka.config import UniforceFrankaConfig
from uniforce_robots.franka.franky_arm import FrankyArm
from uniforce_robots.franka.franky_hand import FrankyHand
from uniforce_robots.franka.hand import HandDriver
from uniforce_robots.franka.pylibfranka_arm import PylibfrankaArm
from uniforce_robots.franka.pylibfranka_hand import PylibfrankaHand


def make_backend(config: UniforceFrankaConfig) -> tuple[Arm, HandDriver]:
    """Return the arm and hand of the configured backend, not yet connected."""
    if config.backend == "pylibfranka":
        return PylibfrankaArm(config.arm_settings), PylibfrankaHand(config.address, config.connect_deadline_s)
    return FrankyArm(config.arm_settings, has_hand=True), FrankyHand(config.address)
