"""LeRobot's phone as a pose that moves the target while its button is held. Never run with one.

Needs ``lerobot[phone]``. LeRobot's own processor maps the phone's axes to the robot's. Pressing the button latches
where target and phone are;
letting go holds the target, so that the arm can be led in several strokes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator
from lerobot.teleoperators.phone.config_phone import PhoneConfig, PhoneOS
from lerobot.teleoperators.phone.phone_processor import MapPhoneActionToRobotAction

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforcePhoneConfig
from uniforce_vtla.errors import TeleoperatorError, expected

MOVES = ("target_x", "target_y", "target_z", "target_wz")


class UniforcePhone(UniforceTeleoperator):
    """Move the phone with its button held (B1 on iOS, touch on Android)."""

    config_class = UniforcePhoneConfig
    name = "uniforce_phone"

    def __init__(self, config: UniforcePhoneConfig) -> None:
        super().__init__(config, config.limits)
        self.config = config
        self.device: Teleoperator | None = None
        self._map = MapPhoneActionToRobotAction(PhoneOS(config.phone_os))
        self._latched: tuple[np.ndarray, np.ndarray] | None = None  # target (5,) and phone (4,) at the press
        self._seen: np.ndarray | None = None
        self._seen_s = 0.0

    @property
    def is_connected(self) -> bool:
        """Whether LeRobot's phone is connected."""
        return self.device is not None and self.device.is_connected

    def make_device(self) -> Teleoperator:
        """Return LeRobot's teleoperator, not yet connected.

        Raises:
            ImportError: hebi or teleop is not installed.
        """
        from lerobot.teleoperators.phone.teleop_phone import (
            Phone,
        )  # not at the top: it may warn of what is missing

        inner = PhoneConfig(id=self.config.id, calibration_dir=self.config.calibration_dir)
        inner.phone_os = PhoneOS(self.config.phone_os)
        return Phone(inner)

    def _open(self) -> None:
        try:
            device = self.make_device()
            device.connect()  # waits for the person to show how the phone is held
        except ImportError as error:
            do = 'Install them: pip install "lerobot[phone]".'
            raise TeleoperatorError(expected(self.name, "hebi or teleop", error, do), "missing") from error
        except (RuntimeError, OSError) as error:
            do = "Open the app, in the same network."
            raise TeleoperatorError(expected(self.name, "a phone", error, do), "connection") from error
        self.device = device

    def _close(self) -> None:
        device, self.device = self.device, None
        if device is not None:
            device.disconnect()

    def _begin(self, measured: np.ndarray) -> None:
        self._latched, self._seen, self._seen_s = None, None, self.clock()

    def _next(self, elapsed_s: float) -> np.ndarray:
        said = self._said()
        goal = self.integrator.target
        if said is not None and said["enabled"]:
            goal = self._goal(np.array([said[name] for name in MOVES], dtype=np.float64))
        else:
            self._latched = None
        speed = 0.0 if said is None else float(said["gripper_vel"])
        width = self.integrator.limits.speed[4] * np.clip(speed, -1, 1) * min(elapsed_s, 0.1)
        goal[4] = self.integrator.target[4] + width
        return self.integrator.towards(goal, elapsed_s, self.measured)

    def _goal(self, phone: np.ndarray) -> np.ndarray:
        if self._latched is None:
            self._latched = (self.integrator.target, phone)
        target, start = self._latched
        return np.array([*(target[:4] + phone - start), target[4]])

    def _said(self) -> dict[str, Any] | None:
        """Return the mapped action, None while the phone has no pose.

        Raises:
            TeleoperatorError: it has been without a pose, or frozen with its button held, for too long.
        """
        assert self.device is not None  # get_action has looked
        try:
            raw = self.device.get_action()
        except (
            RuntimeError,
            OSError,
            TypeError,
        ) as error:  # TypeError: HEBI answers None once the phone is gone
            raise TeleoperatorError(
                expected(self.name, "a pose", error, "Reconnect it."), "connection"
            ) from error
        said = self._map.action(dict(raw)) if raw else None
        seen = None if said is None else np.array([*raw["phone.pos"], *raw["phone.rot"].as_quat()])
        self._check_alive(said, seen)
        return said

    def _check_alive(self, said: dict[str, Any] | None, seen: np.ndarray | None) -> None:
        is_same = seen is None or (self._seen is not None and np.array_equal(seen, self._seen))
        may_rest = said is not None and not said["enabled"]
        if may_rest or not is_same:  # a held phone is never still to the last bit
            self._seen, self._seen_s = seen, self.clock()
        silent_s = self.clock() - self._seen_s
        if silent_s > self.config.silent_s:
            came = f"none, or the very same one, for {silent_s:.1f} s"
            do = "Check its network and that the camera sees the room."
            raise TeleoperatorError(expected(self.name, "a changing pose", came, do), "stale")
