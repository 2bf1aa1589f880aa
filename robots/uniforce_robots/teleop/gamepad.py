"""LeRobot's gamepad as rates of a target. Needs ``lerobot[gamepad]`` (pygame) or hidapi. Never run with a pad.

LeRobot's class gives x, y, z and the fingers; no turn, and a pad that is unplugged while pygame reads it looks like one
nobody touches: the robot stays where it is, and no error is raised.
"""

from __future__ import annotations

import numpy as np
from lerobot.teleoperators import Teleoperator
from lerobot.teleoperators.gamepad import GamepadTeleop, GamepadTeleopConfig

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceGamepadConfig
from uniforce_vtla.errors import TeleoperatorError, expected

GRIPPER_STAYS = 1.0  # LeRobot's: 0 closes, 1 stays, 2 opens


class UniforceGamepad(UniforceTeleoperator):
    """Left stick x and y, right stick z, LeRobot's gripper buttons; the yaw stays where the episode began."""

    config_class = UniforceGamepadConfig
    name = "uniforce_gamepad"

    def __init__(self, config: UniforceGamepadConfig) -> None:
        super().__init__(config, config.limits)
        self.config = config
        self.device: Teleoperator | None = None

    @property
    def is_connected(self) -> bool:
        """Whether LeRobot's pad is open."""
        return self.device is not None and self.device.is_connected

    def make_device(self) -> Teleoperator:
        """Return LeRobot's teleoperator, not yet connected."""
        inner = GamepadTeleopConfig(id=self.config.id, calibration_dir=self.config.calibration_dir)
        inner.hidapi_fallback = self.config.hidapi
        return GamepadTeleop(inner)

    def _open(self) -> None:
        device = self.make_device()
        try:
            device.connect()
        except ImportError as error:
            do = 'Install it: pip install "lerobot[gamepad]".'
            raise TeleoperatorError(expected(self.name, "pygame or hidapi", error, do), "missing") from error
        if not device.gamepad.running:
            device.disconnect()
            do = "Plug it in and press a button; or set hidapi=true."
            raise TeleoperatorError(expected(self.name, "a gamepad", "none", do), "connection")
        self.device = device

    def _close(self) -> None:
        device, self.device = self.device, None
        if device is not None:
            device.disconnect()

    def _next(self, elapsed_s: float) -> np.ndarray:
        assert self.device is not None  # get_action has looked
        said = self.device.get_action()
        x, y, z = (float(said[f"delta_{axis}"]) for axis in "xyz")
        rates = np.array([x, y, z, 0.0, float(said["gripper"]) - GRIPPER_STAYS])
        return self.integrator.advance(rates, elapsed_s, self.measured)
