"""Teleoperators whose actions are the five absolute axes; importing this package registers them.

No device or library is touched before ``connect``. None of them has ever run on hardware.
"""

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.gello import UniforceGello, UniforceGelloConfig
from uniforce_robots.teleop.keyboard import (
    UniforceHandGuide,
    UniforceHandGuideConfig,
    UniforceKeyboard,
    UniforceKeyboardConfig,
)
from uniforce_robots.teleop.spacemouse import UniforceSpaceMouse, UniforceSpaceMouseConfig

__all__ = [
    "UniforceGello",
    "UniforceGelloConfig",
    "UniforceHandGuide",
    "UniforceHandGuideConfig",
    "UniforceKeyboard",
    "UniforceKeyboardConfig",
    "UniforceSpaceMouse",
    "UniforceSpaceMouseConfig",
    "UniforceTeleoperator",
]
