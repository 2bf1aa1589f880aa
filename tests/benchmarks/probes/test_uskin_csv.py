from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.probes.uskin_csv import COLUMNS, read_uskin_csv
from uniforce_vtla.errors import SensorError


@pytest.fixture
def table() -> pd.DataFrame:
    counts = np.random.default_rng(0).integers(0, 65_536, (5, 48)).astype(float)
    return pd.DataFrame(counts, columns=COLUMNS)


def test_columns_become_taxels_and_axes(tmp_path: Path, table: pd.DataFrame):
    table.insert(0, "time", 0.1)  # extra columns and another order don't matter
    table[["time", *reversed(COLUMNS)]].to_csv(tmp_path / "log.csv", index=False)
    counts = read_uskin_csv(tmp_path / "log.csv")
    assert counts.shape == (5, 16, 3) and counts.dtype == np.int64
    assert counts[3, 6, 1] == table["txl7_y"][3] and counts[0, 15, 2] == table["txl16_z"][0]


def test_missing_column(tmp_path: Path, table: pd.DataFrame):
    table.drop(columns="txl9_z").to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(SensorError, match="txl9_z missing"):
        read_uskin_csv(tmp_path / "log.csv")


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.5, "x"])
def test_bad_cell(tmp_path: Path, table: pd.DataFrame, bad: object):
    table = table.astype(object)
    table.loc[2, "txl4_x"] = bad
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(SensorError, match="missing or fractional"):
        read_uskin_csv(tmp_path / "log.csv")


def test_no_file_no_rows_and_empty_file(tmp_path: Path, table: pd.DataFrame):
    with pytest.raises(SensorError, match="no file"):
        read_uskin_csv(tmp_path / "absent.csv")
    table[:0].to_csv(tmp_path / "head.csv", index=False)
    with pytest.raises(SensorError, match="no rows"):
        read_uskin_csv(tmp_path / "head.csv")
    (tmp_path / "empty.csv").touch()
    with pytest.raises(SensorError, match="empty file"):
        read_uskin_csv(tmp_path / "empty.csv")
