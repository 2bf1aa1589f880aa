"""A uSkin patch as a LeRobot camera: its counts drawn as the marker image, so that fingers look alike to a robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uniforce_robots.sensors.config_uniforce import UniforceUskinConfig
from uniforce_robots.sensors.finger import TactileFinger, taxel_median
from uniforce_robots.sensors.samples import Window
from uniforce_robots.sensors.sources import USkinSource
from uniforce_robots.sensors.uskin_replay import ReplayUSkin
from uniforce_robots.sensors.uskin_server import ServerUSkin
from uniforce_robots.sensors.uskin_slcan import SlcanUSkin


def make_uskin_source(config: UniforceUskinConfig) -> USkinSource:
    """Return the source that ``config.link`` names."""
    match config.link:
        case "slcan":
            ids = tuple(config.can_ids) or None
            return SlcanUSkin(config.source, ids, config.label, config.controller)
        case "server":
            return ServerUSkin(config.source, config.server_sensor, config.label)
        case _:
            return ReplayUSkin(config.source, config.replay_rate_hz, config.replay_loop, config.label)


class UniforceUskin(TactileFinger):
    """A uSkin finger; see ``TactileFinger``.  ``latest().raw`` is (16, 3) uint16 counts."""

    capacity = 1024  # 2 s at 500 scans/s

    def __init__(self, config: UniforceUskinConfig) -> None:
        self._resting_level = config.resting_level
        self._uskin_config = config
        super().__init__(config)

    def _make_source(self) -> USkinSource:
        return make_uskin_source(self._uskin_config)

    def upright_window(self, size: int) -> Window:
        """Return the newest ``size`` scans turned as ``latest`` turns them; raises as ``read_latest``."""
        window = self.window(size)
        return replace(window, data=np.stack([self._upright(scan) for scan in window.data]))

    def _upright(self, raw: np.ndarray) -> np.ndarray:
        return self._orientation.of_counts(raw)

    def _median(self, samples: list[np.ndarray]) -> np.ndarray:
        return taxel_median(samples, self._resting_level)
