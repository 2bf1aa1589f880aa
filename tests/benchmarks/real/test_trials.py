from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.real.grasps import COLUMNS, read_trials, read_uskin_csv
from uniforce_vtla.errors import DatasetError, SensorError

FOLDER = Path(__file__).parents[3].parent / "shared" / "real" / "uskin_bilateral_slip" / "data_set"
HERE = "b"  # the trial that lends its reference
T = 60


def write_trial(folder: Path, drop: int | None, seed: int) -> None:
    """Write a trial of 60 frames: a grasp of 400 counts per taxel."""
    rng = np.random.default_rng(seed)
    measured = 400 + 3 * rng.standard_normal((2, T, 16, 3))
    measured[..., :2] -= 400
    labels = np.zeros((T, 2))
    if drop is not None:
        measured[:, drop:, :, 2] -= 400
        labels[drop:, 1] = 1
    folder.mkdir(parents=True)
    for name, counts in zip(("xela_sensor1.csv", "xela_sensor2.csv"), measured, strict=True):
        table = pd.DataFrame(np.rint(counts + 30_000).astype(int).reshape(T, 48), columns=COLUMNS)
        table.to_csv(folder / name, index=False)
    pd.DataFrame(labels, columns=["slip", "fail"]).to_csv(folder / "slip_label.csv", index=False)


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    write_trial(tmp_path / "a", None, seed=1)
    write_trial(tmp_path / "b", 40, seed=2)
    write_trial(tmp_path / "c", None, seed=3)
    return tmp_path


def test_references_are_own_where_the_object_fell_and_else_borrowed_and_labelled(recordings: Path) -> None:
    trials = {t.name: t for t in read_trials(recordings, HERE)}
    assert trials["b"].reference_from == "own" and trials["c"].reference_from == "borrowed from b"
    np.testing.assert_array_equal(trials["c"].reference, trials["b"].reference)
    assert np.abs(trials["c"].reference - 30_000).max() < 10
    assert trials["b"].changes_load and not trials["c"].changes_load


def test_bad_recordings_raise(recordings: Path) -> None:
    with pytest.raises(DatasetError, match="none"):
        read_trials(recordings / "absent", HERE)
    with pytest.raises(DatasetError, match="drop"):
        read_trials(recordings, "c")
    labels = recordings / "a" / "slip_label.csv"
    pd.read_csv(labels)[:-1].to_csv(labels, index=False)
    with pytest.raises(DatasetError, match="one length"):
        read_trials(recordings, HERE)
    labels.unlink()
    with pytest.raises(DatasetError, match=r"slip_label\.csv"):
        read_trials(recordings, HERE)


@pytest.mark.real
@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no real recordings at {FOLDER}")
def test_real_trials_are_what_the_report_says() -> None:
    trials = read_trials(FOLDER)
    assert len(trials) == 7 and sum(t.reference_from == "own" for t in trials) == 2
    assert sum(t.changes_load for t in trials) == 4


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
