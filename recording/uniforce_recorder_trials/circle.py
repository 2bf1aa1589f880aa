"""Somebody who steers the robot round a level circle at a steady speed: when it stops is plain to see."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from uniforce_vtla.keys import AXES

NEAR_m = 1e-3  # so near to home any direction will do


@TeleoperatorConfig.register_subclass("trial_circle")
@dataclass
class CircleConfig(TeleoperatorConfig):
    """How to go round; 63 mm/s unless told otherwise."""

    radius_m: float = 0.02  # within the guards' box around the arm's home
    period_s: float = 2.0  # of one round
    tick_s: float = 1 / 30  # between two calls
    width_m: float = 0.08  # an open hand: references are taken in free air


class Circle(Teleoperator):
    """Steers from where it was told to start, round a centre on the way home: no start leads farther than 4 cm away."""

    config_class = CircleConfig
    name = "trial_circle"

    def __init__(self, config: CircleConfig) -> None:
        super().__init__(config)
        self.config = config
        self._start: dict[str, float] = {}
        self._home_m = self._centre_m = self._arm_m = 0j  # complex: x + iy
        self._calls = 0
        self._connected = False

    @property
    def action_features(self) -> dict[str, type]:
        """Five absolute targets."""
        return dict.fromkeys(AXES, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        """None."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether ``connect`` was called."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Nothing to calibrate."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Begin."""
        self._connected = True

    def disconnect(self) -> None:
        """End."""
        self._connected = False

    def calibrate(self) -> None:
        """Nothing to calibrate."""

    def configure(self) -> None:
        """Nothing to configure."""

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Feels nothing."""

    def start_from(self, axes: dict[str, float]) -> None:
        """Begin the round here; the first start is home."""
        here_m = complex(axes["x.pos"], axes["y.pos"])
        if not self._start:
            self._home_m = here_m
        way_m = self._home_m - here_m
        towards = way_m / abs(way_m) if abs(way_m) > NEAR_m else 1
        self._start, self._calls = dict(axes), 0
        self._centre_m = here_m + self.config.radius_m * towards
        self._arm_m = here_m - self._centre_m

    def get_action(self) -> dict[str, float]:
        """Return the next point of the circle."""
        self._calls += 1
        angle_rad = 2 * math.pi * self._calls * self.config.tick_s / self.config.period_s
        point_m = self._centre_m + self._arm_m * cmath.exp(1j * angle_rad)
        x_m, y_m = point_m.real, point_m.imag
        return {**self._start, "x.pos": x_m, "y.pos": y_m, "width.pos": self.config.width_m}
