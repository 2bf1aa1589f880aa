"""A teleoperator that steers round a level circle at a steady speed: a stop is plain to see."""

import cmath
import math
from dataclasses import dataclass

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.teleop.base import UniforceTeleoperator

NEAR_m = 1e-3  # so near to home any direction will do
RADIUS_m = 0.02  # within the guards' box around the arm's home
PERIOD_s = 2.0  # of one round: 63 mm/s
WIDTH_m = 0.08  # an open hand: references are taken in free air


@TeleoperatorConfig.register_subclass("trial_circle")
@dataclass
class CircleConfig(TeleoperatorConfig):
    """Seconds between two calls."""

    tick_s: float = 1 / 30


class Circle(UniforceTeleoperator):
    """Steers round a centre on the way home: no start leads farther than 4 cm away."""

    config_class = CircleConfig
    name = "trial_circle"
    is_connected = False

    def __init__(self, config: CircleConfig) -> None:
        super().__init__(config)
        self.config = config
        self._start = np.zeros(5)
        self._home_m: complex | None = None  # x + iy; the first start
        self._centre_m = self._arm_m = 0j
        self._calls = 0

    def _open(self) -> None:
        self.is_connected = True

    def _close(self) -> None:
        self.is_connected = False

    def _begin(self, measured: np.ndarray) -> None:
        here_m = complex(measured[0], measured[1])
        if self._home_m is None:
            self._home_m = here_m
        way_m = self._home_m - here_m
        towards = way_m / abs(way_m) if abs(way_m) > NEAR_m else 1
        self._start, self._calls = measured, 0
        self._centre_m = here_m + RADIUS_m * towards
        self._arm_m = here_m - self._centre_m

    def _next(self, elapsed_s: float) -> np.ndarray:
        self._calls += 1
        angle_rad = 2 * math.pi * self._calls * self.config.tick_s / PERIOD_s
        point_m = self._centre_m + self._arm_m * cmath.exp(1j * angle_rad)
        return np.array([point_m.real, point_m.imag, *self._start[2:4], WIDTH_m])
