"""LeRobot's own gamepad and phone, turned into the project's absolute axes. Never run with a pad or a phone.

They need ``lerobot[gamepad]`` (pygame) and ``lerobot[phone]`` (hebi, teleop). A pad that is unplugged while pygame
reads it looks like one at rest: the robot stays where it is, and no error is raised.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.teleoperators.gamepad import GamepadTeleop, GamepadTeleopConfig
from lerobot.teleoperators.phone.config_phone import PhoneConfig, PhoneOS
from lerobot.teleoperators.phone.phone_processor import MapPhoneActionToRobotAction

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.integrator import SteeringConfig, TargetLimits
from uniforce_vtla.errors import TeleoperatorError, expected

GRIPPER_STAYS = 1.0  # LeRobot's: 0 closes, 1 stays, 2 opens
PHONE_MOVES = ("target_x", "target_y", "target_z", "target_wz")


@TeleoperatorConfig.register_subclass("uniforce_gamepad")
@dataclass(kw_only=True)
class UniforceGamepadConfig(SteeringConfig):
    """LeRobot's own gamepad; three axes and the fingers, no turn; the limits are speeds at full deflection."""


@TeleoperatorConfig.register_subclass("uniforce_phone")
@dataclass(kw_only=True)
class UniforcePhoneConfig(SteeringConfig):
    """LeRobot's own phone: its pose moves the target while its button is held."""

    limits: TargetLimits = field(default_factory=lambda: TargetLimits(speed=(0.2, 0.2, 0.2, 1.2, 0.06)))
    phone_os: Literal["ios", "android"] = "ios"  # HEBI Mobile I/O, or a WebXR page
    silent_s: float = 0.5  # without a pose, or with the very same one, for so long it is lost


class LerobotsOwn(UniforceTeleoperator):
    """Reads ``device``, LeRobot's teleoperator, while connected."""

    extra: ClassVar[str]
    do_connect: ClassVar[str]

    @abstractmethod
    def make_device(self) -> Teleoperator:
        """Return LeRobot's teleoperator, not yet connected; raises ImportError where its library is missing."""

    @property
    def is_connected(self) -> bool:
        """Whether LeRobot's device is open."""
        return self.device is not None and self.device.is_connected

    def _open(self) -> None:
        try:
            device = self.make_device()
            device.connect()
        except ImportError as error:
            do = f'Install it: pip install "lerobot[{self.extra}]".'
            raise TeleoperatorError(expected(self.name, "its library", error, do), "missing") from error
        except (RuntimeError, OSError) as error:
            came = expected(self.name, "a device", error, self.do_connect)
            raise TeleoperatorError(came, "connection") from error
        self.device = device

    def _close(self) -> None:
        device, self.device = self.device, None
        if device is not None:
            device.disconnect()


class UniforceGamepad(LerobotsOwn):
    """Left stick x and y, right stick z, LeRobot's gripper buttons; the yaw stays where the episode began."""

    config_class = UniforceGamepadConfig
    name, extra = "uniforce_gamepad", "gamepad"
    do_connect = "Plug it in and press a button."

    def make_device(self) -> Teleoperator:
        """Return LeRobot's gamepad."""
        folder = self.config.calibration_dir
        return GamepadTeleop(GamepadTeleopConfig(id=self.config.id, calibration_dir=folder))

    def _open(self) -> None:
        super()._open()
        if not self.device.gamepad.running:
            self._close()
            raise TeleoperatorError(expected(self.name, "a gamepad", "none", self.do_connect), "connection")

    def _next(self, elapsed_s: float) -> np.ndarray:
        action = self.device.get_action()
        moves = [float(action[f"delta_{axis}"]) for axis in "xyz"]
        rates = np.array([*moves, 0.0, float(action["gripper"]) - GRIPPER_STAYS])
        return self.integrator.advance(rates, elapsed_s, self.measured)


class UniforcePhone(LerobotsOwn):
    """Move the phone with its button held (B1 on iOS, touch on Android).

    LeRobot's processor maps the phone's axes to the robot's. Pressing the button latches where target and phone are;
    letting go holds the target, so that the arm can be led in several strokes.
    """

    config_class = UniforcePhoneConfig
    name, extra = "uniforce_phone", "phone"
    do_connect = "Open the app, in the same network."

    def __init__(self, config: UniforcePhoneConfig) -> None:
        super().__init__(config)
        self._map = MapPhoneActionToRobotAction(PhoneOS(config.phone_os))
        self._latched: tuple[np.ndarray, np.ndarray] | None = None  # target (5,) and phone (4,) at the press
        self._seen: np.ndarray | None = None
        self._seen_s = 0.0

    def make_device(self) -> Teleoperator:
        """Return LeRobot's phone, which waits in ``connect`` for the person to show how it is held."""
        # not at the top: it may warn of what is missing
        from lerobot.teleoperators.phone.teleop_phone import Phone

        inner = PhoneConfig(id=self.config.id, calibration_dir=self.config.calibration_dir)
        inner.phone_os = PhoneOS(self.config.phone_os)
        return Phone(inner)

    def _begin(self, measured: np.ndarray) -> None:
        self._latched, self._seen, self._seen_s = None, None, self.clock()

    def _next(self, elapsed_s: float) -> np.ndarray:
        action, goal = self._mapped(), self.integrator.target
        if action is not None and action["enabled"]:
            phone = np.array([action[name] for name in PHONE_MOVES], dtype=np.float64)
            self._latched = self._latched or (goal, phone)
            target, start = self._latched
            goal = np.array([*(target[:4] + phone - start), goal[4]])
        else:
            self._latched = None
        speed = 0.0 if action is None else float(action["gripper_vel"])
        goal[4] += self.integrator.limits.speed[4] * np.clip(speed, -1, 1) * min(elapsed_s, 0.1)
        return self.integrator.towards(goal, elapsed_s, self.measured)

    def _mapped(self) -> dict[str, Any] | None:
        """Return the mapped action, None while the phone has no pose.

        Raises:
            TeleoperatorError: it has been without a pose, or frozen with its button held, for too long.
        """
        try:
            raw = self.device.get_action()
        except (RuntimeError, OSError, TypeError) as error:  # HEBI answers None once the phone is gone
            came = expected(self.name, "a pose", error, "Reconnect it.")
            raise TeleoperatorError(came, "connection") from error
        action = self._map.action(dict(raw)) if raw else None
        seen = None if action is None else np.array([*raw["phone.pos"], *raw["phone.rot"].as_quat()])
        may_rest = action is not None and not action["enabled"]
        is_same = seen is None or (self._seen is not None and np.array_equal(seen, self._seen))
        if may_rest or not is_same:  # a held phone is never still to the last bit
            self._seen, self._seen_s = seen, self.clock()
        silent_s = self.clock() - self._seen_s
        if silent_s > self.config.silent_s:
            came = f"none, or the very same one, for {silent_s:.1f} s"
            do = "Check its network and that the camera sees the room."
            raise TeleoperatorError(expected(self.name, "a changing pose", came, do), "stale")
        return action
