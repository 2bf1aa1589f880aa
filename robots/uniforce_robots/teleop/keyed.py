"""What every teleoperator with keys of a terminal shares: they are read while it is connected, forgotten at a start."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.integrator import TargetLimits
from uniforce_robots.teleop.terminal_keys import TerminalKeys

X, Y, Z, YAW, WIDTH = range(5)
# n, r, q and the arrows are left to a recorder.
WIDTH_KEYS = {"o": (WIDTH, 1), "p": (WIDTH, -1)}


class KeyedTeleoperator(UniforceTeleoperator):
    """Read ``keys``: letter → (axis, direction)."""

    def __init__(
        self, config: TeleoperatorConfig, limits: TargetLimits, keys: Mapping[str, tuple[int, int]]
    ) -> None:
        super().__init__(config, limits)
        self.config = config
        self.keys = TerminalKeys(dict(keys))

    @property
    def is_connected(self) -> bool:
        """Whether keys are read."""
        return self.keys.is_listening

    def _open(self) -> None:
        self.keys.start()

    def _close(self) -> None:
        self.keys.stop()

    def _begin(self, measured: np.ndarray) -> None:
        self.keys.forget()
