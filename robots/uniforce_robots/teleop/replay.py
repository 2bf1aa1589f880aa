"""Actions from a file, row by row: for tests, and to show again what a person did."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow

from uniforce_robots.teleop.base import UniforceTeleoperator
from uniforce_robots.teleop.configs import UniforceReplayConfig
from uniforce_vtla.errors import TeleoperatorError, expected
from uniforce_vtla.keys import ACTION, AXES

EPISODE = "episode_index"
SUFFIXES = (".npz", ".csv", ".parquet")


def read_actions(path: str | Path, episode: int | None = None) -> np.ndarray:
    """Return (T, 5) float64 of one episode, T ≥ 1, finite.

    A .npz holds ``action`` (T, 5), a .csv columns named as ``keys.AXES``, a .parquet a column ``action`` of lists;
    ``episode_index`` beside them says where one episode ends.

    Raises:
        TeleoperatorError: no such file (``connection``), another form, several episodes and none chosen (``garbage``).
    """
    path = Path(path)
    if path.suffix not in SUFFIXES or not path.is_file():
        wanted = f"a file ending in {' | '.join(SUFFIXES)}"
        raise TeleoperatorError(expected("replay", wanted, repr(str(path)), "Name one."), "connection")
    try:
        actions, episodes = _load(path)
    except (KeyError, ValueError, EOFError, OSError, zipfile.BadZipFile, pyarrow.ArrowException) as error:
        raise _garbage(path, f"(T, 5) of {AXES}", repr(error)) from error
    known = np.unique(episodes)
    if episode is not None or len(known) > 1:
        if episode not in known:
            raise _garbage(path, f"one of episodes {known.tolist()}", episode)
        actions = actions[episodes == episode]
    if (
        actions.ndim != 2
        or actions.shape[1] != len(AXES)
        or not len(actions)
        or not np.isfinite(actions).all()
    ):
        raise _garbage(path, f"(T, 5) finite {AXES}", f"{actions.shape}, or not finite")
    return actions


def _load(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, 5) float64, as far as the file is right, and each row's episode (T,)."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as held:
            columns = {name: held[name] for name in (ACTION, EPISODE) if name in held}
    else:
        table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
        rows = table[list(AXES)].to_numpy() if path.suffix == ".csv" else table[ACTION].tolist()
        columns = {ACTION: rows} | ({EPISODE: table[EPISODE].to_numpy()} if EPISODE in table else {})
    actions = np.asarray(columns[ACTION], dtype=np.float64)
    return actions, columns.get(EPISODE, np.zeros(len(actions), np.int64))


def _garbage(path: Path, wanted: object, came: object) -> TeleoperatorError:
    do = "Is it one episode of absolute targets? Set episode where there are several."
    return TeleoperatorError(expected(str(path), wanted, came, do), "garbage")


class UniforceReplay(UniforceTeleoperator):
    """One row of the file per ``get_action``; after the last one the fault is ``ended``."""

    config_class = UniforceReplayConfig
    name = "uniforce_replay"

    def __init__(self, config: UniforceReplayConfig) -> None:
        super().__init__(config)
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
            wanted = f"a step of at most {self.config.jump[axis]} of {AXES[axis]}"
            raise _garbage(Path(self.config.path), wanted, f"{steps[row, axis]:.4f} to row {row + 1}")
