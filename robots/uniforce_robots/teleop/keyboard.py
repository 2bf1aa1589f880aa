"""Steer with the keys of a terminal, over ssh too. Never used on a real robot."""

from __future__ import annotations

import numpy as np

from uniforce_robots.teleop.configs import UniforceKeyboardConfig
from uniforce_robots.teleop.keyed import WIDTH_KEYS, YAW, KeyedTeleoperator, X, Y, Z

KEYS = {
    "w": (X, 1), "s": (X, -1), "a": (Y, 1), "d": (Y, -1), "e": (Z, 1), "c": (Z, -1), "j": (YAW, 1), "l": (YAW, -1),
    **WIDTH_KEYS,
}  # fmt: skip


class UniforceKeyboard(KeyedTeleoperator):
    """w s a d along base x and y, e c up and down, j l turn, o p open and close; a held key moves on."""

    config_class = UniforceKeyboardConfig
    name = "uniforce_keyboard"

    def __init__(self, config: UniforceKeyboardConfig) -> None:
        super().__init__(config, config.limits, KEYS)

    def _next(self, elapsed_s: float) -> np.ndarray:
        return self.integrator.advance(self.keys.rates(), elapsed_s, self.measured)
