"""Any LeRobot teleoperator whose actions are the five absolute axes, as a function of the measured ones."""

from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator

from uniforce_vtla.errors import ContractError, TeleoperatorError, UniForceError, expected
from uniforce_vtla.keys import AXES


class Steering:
    """Drive by a teleoperator; TeleoperatorError where it fails.

    Beyond LeRobot's interface it uses what is there: ``start_from(axes)`` at each start, ``send_feedback(axes)`` where
    ``feedback_features`` lists the five axes. Not connected at first; ContractError: its actions aren't the five axes.
    """

    def __init__(self, teleop: Teleoperator) -> None:
        missing = [axis for axis in AXES if axis not in teleop.action_features]
        if missing:
            do = "Take one of ours (teleop=keyboard, spacemouse, gello, hand_guide), or wrap it."
            raise ContractError(expected(f"teleop {teleop.name}", f"actions {AXES}", f"{missing} missing", do))
        self._teleop: Any = teleop
        self.name = str(teleop.name)
        self._wants_feedback = all(axis in teleop.feedback_features for axis in AXES)

    def connect(self) -> None:
        """Open the device."""
        self._call("connect")

    def close(self) -> None:
        """Let go of it."""
        if self._teleop.is_connected:
            self._call("disconnect")

    def start_from(self, axes: np.ndarray) -> None:
        """Begin with the target on (5,) measured axes; raises TeleoperatorError where it can't start from here."""
        if hasattr(self._teleop, "start_from"):
            self._call("start_from", _named(axes))

    def target(self, axes: np.ndarray) -> np.ndarray:
        """Return (5,) absolute targets for the (5,) measured axes.

        Raises TeleoperatorError: the device failed, or its target isn't finite.
        """
        if self._wants_feedback:
            self._call("send_feedback", _named(axes))
        action = self._call("get_action")
        target = np.array([float(action.get(axis, np.nan)) for axis in AXES])
        if not np.isfinite(target).all():
            do = "The teleoperator is broken; the robot holds."
            raise TeleoperatorError(expected(self.name, f"finite {AXES}", action, do), "garbage")
        return target

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call the device; what LeRobot's own raise becomes one kind of error."""
        try:
            return getattr(self._teleop, method)(*arguments)
        except UniForceError:
            raise
        except (RuntimeError, OSError, ValueError) as error:
            came = expected(self.name, "an answer", error, "Check the device.")
            raise TeleoperatorError(came, "connection") from error


def _named(axes: np.ndarray) -> dict[str, float]:
    return dict(zip(AXES, axes.tolist(), strict=True))
