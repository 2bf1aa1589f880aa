"""Any LeRobot teleoperator whose actions are the five absolute axes, from measured to target."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator

from uniforce_robots.franka.poses import by_axis
from uniforce_robots.teleop.base import require_near
from uniforce_vtla.errors import ContractError, TeleoperatorError, expected
from uniforce_vtla.keys import AXES

log = logging.getLogger(__name__)


class Steering:
    """Drive by a teleoperator; TeleoperatorError where it fails.

    Beyond LeRobot's interface it uses ``start_from(axes)`` at each start if there is one, and
    ``send_feedback(axes)`` where ``feedback_features`` lists the five axes. Not connected at first.

    Raises ContractError: its actions aren't the five axes.
    """

    def __init__(self, teleop: Teleoperator) -> None:
        self._teleop: Any = teleop
        self.name = str(teleop.name)
        with self._named():
            missing = [axis for axis in AXES if axis not in teleop.action_features]
            self._wants_feedback = all(axis in teleop.feedback_features for axis in AXES)
        if missing:
            do = "Take one of ours (teleop=keyboard, spacemouse, gello, hand_guide), or wrap it."
            raise ContractError(
                expected(f"teleop {self.name}", f"actions {AXES}", f"{missing} missing", do)
            )

    def connect(self) -> None:
        """Open the device; raises TeleoperatorError."""
        with self._named():
            self._teleop.connect()

    def close(self) -> None:
        """Let go of it; never raises: the robot and what was recorded must be seen to."""
        try:
            with self._named():
                if self._teleop.is_connected:
                    self._teleop.disconnect()
        except TeleoperatorError as error:
            log.warning("%s", error)

    def start_from(self, axes: np.ndarray) -> None:
        """Begin on (5,) measured axes; raises TeleoperatorError where it can't start from here.

        One that has a pose of its own, as any leader arm, must stand where the robot is.
        """
        if not hasattr(self._teleop, "start_from"):
            require_near(self.name, self.target(axes), axes)
            return
        with self._named():
            self._teleop.start_from(by_axis(axes))

    def target(self, axes: np.ndarray) -> np.ndarray:
        """Return (5,) absolute targets for the (5,) measured axes.

        Raises TeleoperatorError: the device failed, or its target isn't finite.
        """
        with self._named():
            if self._wants_feedback:
                self._teleop.send_feedback(by_axis(axes))
            action = self._teleop.get_action()
            target = np.array([float(action[axis]) for axis in AXES])
        if not np.isfinite(target).all():
            do = "The teleoperator is broken; the robot holds."
            raise TeleoperatorError(expected(self.name, f"finite {AXES}", action, do), "garbage")
        return target

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Turn whatever a device raises into one kind of error: it may be anybody's code."""
        try:
            yield
        except TeleoperatorError:
            raise
        except Exception as error:
            came = f"{type(error).__name__}: {error}"
            raise TeleoperatorError(
                expected(self.name, "an answer", came, "Check the device."), "other"
            ) from error
