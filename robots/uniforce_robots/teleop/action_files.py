"""Read absolute targets (T, 5) from .npz, .csv or a LeRobot dataset's .parquet."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow

from uniforce_vtla.errors import TeleoperatorError, expected
from uniforce_vtla.keys import ACTION, AXES

EPISODE = "episode_index"


def read_actions(path: str | Path, episode: int | None = None) -> np.ndarray:
    """Return (T, 5) float64 of one episode, T ≥ 1, finite.

    A .npz holds ``action`` (T, 5), a .csv columns named as ``keys.AXES``, a .parquet a column ``action`` of lists;
    ``episode_index`` beside them says where one episode ends.

    Raises:
        TeleoperatorError: no such file (``connection``), another form, several episodes and none chosen (``garbage``).
    """
    path = Path(path)
    reader = READERS.get(path.suffix)
    if reader is None or not path.is_file():
        wanted = f"a file ending in {' | '.join(READERS)}"
        raise TeleoperatorError(expected("replay", wanted, repr(str(path)), "Name one."), "connection")
    try:
        actions, episodes = reader(path)
        actions = np.asarray(actions, dtype=np.float64)
    except (KeyError, ValueError, EOFError, OSError, zipfile.BadZipFile, pyarrow.ArrowException) as error:
        do = f"Give (T, 5) of {AXES}."
        raise TeleoperatorError(expected(str(path), "actions", repr(error), do), "garbage") from error
    return _checked(path, _chosen(path, actions, episodes, episode))


def _chosen(path: Path, actions: np.ndarray, episodes: np.ndarray, episode: int | None) -> np.ndarray:
    known = np.unique(episodes)
    if episode is None and len(known) <= 1:
        return actions
    if episode not in known:
        do = "Set episode."
        raise TeleoperatorError(
            expected(str(path), f"one of episodes {known.tolist()}", episode, do), "garbage"
        )
    return actions[episodes == episode]


def _checked(path: Path, actions: np.ndarray) -> np.ndarray:
    is_whole = actions.ndim == 2 and actions.shape[1] == len(AXES) and len(actions) > 0
    if not is_whole or not np.isfinite(actions).all():
        came = f"{actions.shape}, finite: {bool(np.isfinite(actions).all())}"
        raise TeleoperatorError(
            expected(str(path), f"(T, 5) finite {AXES}", came, "Check the file."), "garbage"
        )
    return actions


def _from_npz(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with np.load(path, allow_pickle=False) as held:
        actions = held[ACTION]
        return actions, held[EPISODE] if EPISODE in held else np.zeros(len(actions), np.int64)


def _from_csv(path: Path) -> tuple[np.ndarray, np.ndarray]:
    table = pd.read_csv(path)
    return table[list(AXES)].to_numpy(), _episodes(table)


def _from_parquet(path: Path) -> tuple[np.ndarray, np.ndarray]:
    table = pd.read_parquet(path)
    return np.array(table[ACTION].tolist()), _episodes(table)


def _episodes(table: pd.DataFrame) -> np.ndarray:
    return table[EPISODE].to_numpy() if EPISODE in table else np.zeros(len(table), np.int64)


READERS: dict[str, Callable[[Path], tuple[np.ndarray, np.ndarray]]] = {
    ".npz": _from_npz,
    ".csv": _from_csv,
    ".parquet": _from_parquet,
}
