"""Actions from a file, row by row: for tests, and to show again what a person did."""

from __future__ import annotations

import numpy as np

from uniforce_robots.teleop.action_files import read_actions
from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceReplayConfig
from uniforce_vtla.errors import TeleoperatorError, expected


class UniforceReplay(UniforceTeleoperator):
    """One row of the file per ``get_action``; after the last one the fault is ``ended``."""

    config_class = UniforceReplayConfig
    name = "uniforce_replay"

    def __init__(self, config: UniforceReplayConfig) -> None:
        super().__init__(config)
        self.config = config
        self._actions: np.ndarray | None = None
        self._row = 0

    @property
    def is_connected(self) -> bool:
        """Whether the file is read."""
        return self._actions is not None

    def _open(self) -> None:
        actions = read_actions(self.config.path, self.config.episode)
        self._refuse_jumps(actions)
        self._actions = actions

    def _close(self) -> None:
        self._actions = None

    def _begin(self, measured: np.ndarray) -> None:
        self._row = 0
        self.config.start.check(measured, self._rows()[0], f"{self.name}, first row")

    def _next(self, elapsed_s: float) -> np.ndarray:
        actions = self._rows()
        if self._row >= len(actions):
            came = f"the end after {len(actions)}"
            do = "The recording is over; start_from begins it anew."
            raise TeleoperatorError(expected(self.name, "another row", came, do), "ended")
        self._row += 1
        return actions[self._row - 1]

    def _rows(self) -> np.ndarray:
        assert self._actions is not None  # is_connected has looked
        return self._actions

    def _refuse_jumps(self, actions: np.ndarray) -> None:
        steps = np.abs(np.diff(actions, axis=0))
        over = np.argwhere(steps > self.config.jump)
        if len(over):
            row, axis = over[0]
            what = f"{self.config.path}, row {row + 1}, {list(self.action_features)[axis]}"
            wanted = f"a step of at most {self.config.jump[axis]}"
            do = "Is it one episode of absolute targets?"
            raise TeleoperatorError(expected(what, wanted, f"{steps[row, axis]:.4f}", do), "garbage")
