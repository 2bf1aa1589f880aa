"""The robot's hand: the rules of ``uniforce_vtla.hand``, as the scene's gripper has them, within its hard limits."""

from uniforce_robots.franka.limits import HandSettings
from uniforce_vtla.hand import Hand, require_open

__all__ = ["Hand", "HandSettings", "require_open"]
