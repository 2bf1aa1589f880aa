"""Teleoperators whose actions are the project's five absolute axes.  Importing this package registers them all.

No device or library is touched before ``connect``.  None of them has ever run on hardware.
"""

from lerobot_teleoperator_uniforce.base import UniforceTeleoperator
from lerobot_teleoperator_uniforce.configs import (
    UniforceExpertConfig,
    UniforceGamepadConfig,
    UniforceGelloConfig,
    UniforceHandGuideConfig,
    UniforceKeyboardConfig,
    UniforcePhoneConfig,
    UniforceReplayConfig,
    UniforceSpaceMouseConfig,
)
from lerobot_teleoperator_uniforce.expert import UniforceExpert
from lerobot_teleoperator_uniforce.gamepad import UniforceGamepad
from lerobot_teleoperator_uniforce.gello import UniforceGello
from lerobot_teleoperator_uniforce.hand_guide import UniforceHandGuide
from lerobot_teleoperator_uniforce.keyboard import UniforceKeyboard
from lerobot_teleoperator_uniforce.phone import UniforcePhone
from lerobot_teleoperator_uniforce.replay import UniforceReplay
from lerobot_teleoperator_uniforce.spacemouse import UniforceSpaceMouse

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
