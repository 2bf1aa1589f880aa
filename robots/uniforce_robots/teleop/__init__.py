"""Teleoperators whose actions are the project's five absolute axes.  Importing this package registers them all.

No device or library is touched before ``connect``.  None of them has ever run on hardware.
"""

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import (
    UniforceExpertConfig,
    UniforceGamepadConfig,
    UniforceGelloConfig,
    UniforceHandGuideConfig,
    UniforceKeyboardConfig,
    UniforcePhoneConfig,
    UniforceReplayConfig,
    UniforceSpaceMouseConfig,
)
from uniforce_robots.teleop.expert import UniforceExpert
from uniforce_robots.teleop.gello import UniforceGello
from uniforce_robots.teleop.keyboard import UniforceHandGuide, UniforceKeyboard
from uniforce_robots.teleop.lerobots_own import UniforceGamepad, UniforcePhone
from uniforce_robots.teleop.replay import UniforceReplay
from uniforce_robots.teleop.spacemouse import UniforceSpaceMouse

__all__ = [
    "UniforceExpert",
    "UniforceExpertConfig",
    "UniforceGamepad",
    "UniforceGamepadConfig",
    "UniforceGello",
    "UniforceGelloConfig",
    "UniforceHandGuide",
    "UniforceHandGuideConfig",
    "UniforceKeyboard",
    "UniforceKeyboardConfig",
    "UniforcePhone",
    "UniforcePhoneConfig",
    "UniforceReplay",
    "UniforceReplayConfig",
    "UniforceSpaceMouse",
    "UniforceSpaceMouseConfig",
    "UniforceTeleoperator",
]
