"""Steer with a SpaceMouse: deflection is speed, the buttons close and open the fingers. Never run on hardware."""

from __future__ import annotations

import numpy as np

from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceSpaceMouseConfig
from uniforce_robots.teleop.spacemouse_source import SpaceMouseSource
from uniforce_vtla.errors import TeleoperatorError, expected

FOREVER_MS = 1e12  # a cap at rest is silent for as long as nobody touches it
TURN_ABOUT_Z = 5
# A cap at rest sends nothing, and one held still the same: neither silence nor repetition is a fault of the device.
LIMITS = ReaderLimits(capacity=64, frozen_after=0, silent_s=float("inf"))


class UniforceSpaceMouse(UniforceTeleoperator):
    """Push the cap to move, turn it to turn; left button closes, right button opens."""

    config_class = UniforceSpaceMouseConfig
    name = "uniforce_spacemouse"

    def __init__(self, config: UniforceSpaceMouseConfig) -> None:
        super().__init__(config, config.limits)
        self.config = config
        self.reader = SampleReader(SpaceMouseSource(config.device), LIMITS)

    @property
    def is_connected(self) -> bool:
        """Whether the device is drained."""
        return self.reader.is_running

    def _open(self) -> None:
        self.reader.start()
        self.reader.wait_newer(-1, 1000.0)  # the state of rest, which the source says at once

    def _close(self) -> None:
        self.reader.stop()

    def _begin(self, measured: np.ndarray) -> None:
        if np.abs(self._deflection()).max() > 0:
            do = "Let go of the cap, then start."
            raise TeleoperatorError(expected(self.name, "a cap at rest", "a deflected one", do), "far")

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self.integrator.advance(self.rates(), elapsed_s, self.measured)

    def rates(self) -> np.ndarray:
        """(5,) wanted speed of each axis, −1 … 1.

        Raises:
            TeleoperatorError: a deflected cap has gone silent.
            SensorError: the device is lost.
        """
        state = self._deflection()
        right, forward, up = self.config.signs[:3] * state[:3]
        c, s = np.cos(self.config.operator_yaw_rad), np.sin(self.config.operator_yaw_rad)
        x, y = c * forward + s * right, s * forward - c * right
        turn = self.config.signs[3] * state[TURN_ABOUT_Z]
        return np.array([x, y, up, turn, state[7] - state[6]])

    def _deflection(self) -> np.ndarray:
        """(8,) six axes in −1 … 1 outside the dead band, and two buttons."""
        sample = self.reader.newest(FOREVER_MS)
        state = sample.data.copy()
        share = np.clip(state[:6] / self.config.full_scale, -1, 1)
        beyond = np.maximum(np.abs(share) - self.config.deadband, 0) / (1 - self.config.deadband)
        state[:6] = np.sign(share) * beyond
        silent_s = sample.age_ms() / 1e3
        if beyond.any() and silent_s > self.config.silent_s:
            came = f"none for {silent_s:.2f} s with the cap deflected"
            do = "Replug it, or its receiver."
            raise TeleoperatorError(expected(self.name, "reports", came, do), "stale")
        return state
