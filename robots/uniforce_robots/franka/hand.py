"""The robot's hand: the rules of ``uniforce_vtla.hand``, which the scene's gripper follows too, within its hard limits."""

from uniforce_robots.franka.limits import HandSettings
from uniforce_vtla.hand import Hand, require_open

__all__ = ["Hand", "HandSettings", "require_open"]
