"""Teleoperators whose actions are the project's five absolute axes.  Importing this package registers them all.

No device or library is touched before ``connect``.  None of them has ever run on hardware.
"""

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.expert import UniforceExpert, UniforceExpertConfig
from uniforce_robots.teleop.gello import UniforceGello, UniforceGelloConfig
from uniforce_robots.teleop.keyboard import (
    UniforceHandGuide,
    UniforceHandGuideConfig,
    UniforceKeyboard,
    UniforceKeyboardConfig,
)
from uniforce_robots.teleop.lerobots_own import (
    UniforceGamepad,
    UniforceGamepadConfig,
    UniforcePhone,
    UniforcePhoneConfig,
)
from uniforce_robots.teleop.spacemouse import UniforceSpaceMouse, UniforceSpaceMouseConfig

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
    "UniforceSpaceMouse",
    "UniforceSpaceMouseConfig",
    "UniforceTeleoperator",
]
