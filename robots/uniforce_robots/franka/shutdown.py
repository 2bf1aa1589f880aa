"""No motion after the end: LeRobot's rollout would lead the arm back to where it began, through whatever is there.

``lerobot-rollout`` does so unless given ``--return_to_initial_position=false``, also on a robot that has just pressed
on a board, or has just been stopped. The robot can't know those actions from a policy's.
"""

from __future__ import annotations

import logging
import sys

log = logging.getLogger(__name__)
STRATEGIES = "lerobot.rollout.strategies.core"


def forbid_return_motion() -> bool:
    """Replace the return motion of LeRobot's rollout strategies by a line in the log, in this process.

    Returns:
        Whether there was anything to replace: outside a rollout the module is not loaded, and is not loaded here.
    """
    module = sys.modules.get(STRATEGIES)
    if module is None:
        return False
    module.RolloutStrategy._return_to_initial_position = staticmethod(_stay)
    return True


def _stay(*_: object, **__: object) -> None:
    log.info("uniforce_franka stays where it is: no motion after the end")
