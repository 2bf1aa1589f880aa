"""Reads logged uSkin trials: one csv per finger, columns ``txl1_x … txl16_z``."""

from pathlib import Path

import numpy as np
import pandas as pd

from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import SensorError, expected

COLUMNS = [f"txl{taxel}_{axis}" for taxel in range(1, TAXEL_SHAPE[0] + 1) for axis in "xyz"]


def read_uskin_csv(path: Path | str) -> np.ndarray:
    """Return a trial's raw counts, (N, 16, 3) int64; extra columns are left aside.

    Raises:
        SensorError: no such file, a missing column, no rows, or a value that isn't a whole number.
    """
    table = _read_table(Path(path))
    missing = [column for column in COLUMNS if column not in table.columns]
    if missing:
        do = "Is this a uSkin 4×4 log?"
        raise SensorError(expected(f"{path}", "columns txl1_x … txl16_z", f"{missing[0]} missing", do))
    values = table[COLUMNS].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)  # (N, 48)
    if len(values) == 0 or not np.isfinite(values).all() or np.any(values != np.rint(values)):
        came = "no rows" if len(values) == 0 else "missing or fractional values"
        do = "Log the raw signal again."
        raise SensorError(expected(f"{path}", "whole counts in every cell", came, do))
    return values.astype(np.int64).reshape(-1, *TAXEL_SHAPE)  # (N, 16, 3)


def _read_table(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise SensorError(expected("uSkin log", "a csv file", f"no file {path}", "Check the path."))
    try:
        return pd.read_csv(path)
    except pd.errors.EmptyDataError as error:
        do = "Log the trial again."
        raise SensorError(expected(f"{path}", "a csv table", "an empty file", do)) from error
