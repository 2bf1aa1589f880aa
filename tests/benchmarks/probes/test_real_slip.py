from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.probes.latent_rotation import Rotation, fit_rotation
from benchmarks.probes.real_slip import balance, real_slip
from benchmarks.probes.real_slip_figure import draw_real_slip
from benchmarks.probes.real_trials import SlipConfig, encode_trial, read_trials
from benchmarks.probes.slip_detector import auroc, change_energy, leave_one_out, starts
from benchmarks.probes.uskin_csv import COLUMNS, read_uskin_csv
from uniforce_vtla.errors import ContractError, DatasetError, SensorError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.settings import TokenizerConfig

FOLDER = Path(__file__).parents[3].parent / "shared" / "real" / "uskin_bilateral_slip" / "data_set"
HERE = SlipConfig(lender="b")
T = 60


def write_trial(folder: Path, slip: slice | None, drop: int | None, seed: int) -> None:
    """Write a trial of 60 frames: a grasp of 400 counts per taxel that shakes while it slips."""
    rng = np.random.default_rng(seed)
    measured = 400 + 3 * rng.standard_normal((2, T, 16, 3))
    measured[..., :2] -= 400
    labels = np.zeros((T, 2))
    if slip is not None:
        measured[:, slip] += 40 * rng.standard_normal((1, slip.stop - slip.start, 16, 3))
        labels[slip, 0] = 1
    if drop is not None:
        measured[:, drop:, :, 2] -= 400
        labels[drop:, 1] = 1
    folder.mkdir(parents=True)
    for name, counts in zip(("xela_sensor1.csv", "xela_sensor2.csv"), measured, strict=True):
        table = pd.DataFrame(np.rint(counts + 30_000).astype(int).reshape(T, 48), columns=COLUMNS)
        table.to_csv(folder / name, index=False)
    pd.DataFrame(labels, columns=["slip", "fail"]).to_csv(folder / "slip_label.csv", index=False)
    speed = pd.DataFrame(rng.standard_normal((T, 2)), columns=["velocity_joint1", "velocity_joint2"])
    speed.to_csv(folder / "robot_state.csv", index=False)


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    write_trial(tmp_path / "a", slice(20, 30), None, seed=1)
    write_trial(tmp_path / "b", slice(25, 40), 40, seed=2)
    write_trial(tmp_path / "c", None, None, seed=3)
    write_trial(tmp_path / "d", slice(10, 20), None, seed=4)
    return tmp_path


@pytest.fixture
def tokenizer() -> Tokenizer:
    return Tokenizer.random(TokenizerConfig(side=32, patch=8, width=16, heads=2, embed_hidden=0))


def test_references_are_own_where_the_object_fell_and_else_borrowed_and_labelled(recordings: Path) -> None:
    trials = {t.name: t for t in read_trials(recordings, HERE)}
    assert trials["b"].reference_from == "own" and trials["c"].reference_from == "borrowed from b"
    np.testing.assert_array_equal(trials["c"].reference, trials["b"].reference)
    assert np.abs(trials["c"].reference - 30_000).max() < 10
    assert trials["b"].load_range_counts > 6_000 > 1_000 > trials["c"].load_range_counts
    assert trials["a"].slip.sum() == 10 and trials["b"].dropped.sum() == 20


def test_signals_start_from_free_air_and_are_mirrored(recordings: Path, tokenizer: Tokenizer) -> None:
    trial = read_trials(recordings, HERE)[1]
    signals = encode_trial(tokenizer, trial, replace(HERE, pool=2))
    assert signals.latent.shape == (2, T, 4, 6) and signals.descriptor.shape == (2, T, 6)
    free, held = np.abs(signals.latent[:, 45:]).mean(), np.abs(signals.latent[:, :20]).mean()
    assert free < 0.3 * held
    raw = trial.counts[1, 5] - trial.reference[1]
    np.testing.assert_array_equal(signals.counts[1, 5], raw * (-1, 1, 1))


def test_whole_report_finds_a_shake_that_speed_and_time_dont_know(recordings, tokenizer, tmp_path) -> None:
    trials = read_trials(recordings, HERE)
    rotation = Rotation("uskin", np.eye(6))
    report, signals, scores = real_slip(tokenizer, trials, rotation, HERE)
    found = report["slip"]["detectors"]
    assert found["raw counts"]["auroc"] > 0.95 and found["latent"]["auroc"] > 0.9
    assert found["control: joint speed"]["auroc"] < 0.75
    assert set(found["latent"]["auroc_by_trial"]) == {"a", "b", "d"}
    assert [report["slip"][what] for what in ("slipping_trials", "onsets", "trials")] == [3, 3, 4]
    assert report["slip"]["frames"] == 3 * T + 40  # what follows the drop is left out
    assert report["balance"]["trials"] == ["b"]
    assert report["balance"]["median"]["raw counts"]["normal"]["r_whole"] > 0.99
    assert [len(score) for score in scores["latent"]] == [T] * 4
    with pytest.raises(ContractError, match="rotation"):
        real_slip(tokenizer, trials, Rotation("uskin", np.eye(5)), HERE)
    drawn = draw_real_slip(report, trials, signals, scores, rotation, tmp_path / "real.png")
    picture = cv2.imread(str(drawn))
    blue = (picture[..., 0].astype(int) - picture[..., 2] > 80).any(axis=1)
    assert all(rows.any() for rows in np.array_split(blue, 4))  # something is drawn in each of its four rows


def test_a_trial_never_scores_itself() -> None:
    rng = np.random.default_rng(0)
    features = [rng.random((200, 3)) for _ in range(4)]
    labels = [rng.random(200) < 0.3 for _ in range(4)]
    kept = [np.ones(200, bool)] * 4
    first = leave_one_out(features, labels, kept, HERE)
    flipped = leave_one_out(features, [~labels[0], *labels[1:]], kept, HERE)
    np.testing.assert_array_equal(first[0][0], flipped[0][0])
    assert not np.array_equal(first[1][0], flipped[1][0])
    found = auroc(np.concatenate([s for s, _ in first]), np.concatenate(labels))
    assert found is not None and 0.4 < found < 0.6  # noise tells nothing


def test_change_energy_looks_back_only() -> None:
    signal = np.zeros((2, 10, 4))
    signal[0, 5:] = 2.0
    energy = change_energy(signal, (1, 3))  # columns: window 1 left, right, window 3 left, right
    np.testing.assert_array_equal(energy[:, 0], [0] * 5 + [2] + [0] * 4)
    np.testing.assert_array_equal(energy[:, 2], [0] * 5 + [2] * 3 + [0] * 2)
    assert not energy[:, [1, 3]].any()


def test_balance_of_equal_scaled_and_opposite_loads() -> None:
    left = np.array([1.0, 2, 3, 4, 0])
    held = np.array([True] * 4 + [False])
    found = balance(left, 1.5 * left, held)
    wanted = {"r_whole": 1, "slope_whole": 1.5, "r_held": 1, "slope_held": 1.5, "ratio_held": 1.5}
    assert found == pytest.approx(wanted)
    assert balance(left, 5 - left, held)["r_held"] == pytest.approx(-1)


def test_bad_recordings_raise(recordings: Path) -> None:
    with pytest.raises(DatasetError, match="none"):
        read_trials(recordings / "absent", HERE)
    with pytest.raises(DatasetError, match="drop"):
        read_trials(recordings, replace(HERE, lender="c"))
    labels = recordings / "a" / "slip_label.csv"
    pd.read_csv(labels)[:-1].to_csv(labels, index=False)
    with pytest.raises(DatasetError, match="one length"):
        read_trials(recordings, HERE)
    labels.unlink()
    with pytest.raises(DatasetError, match=r"slip_label\.csv"):
        read_trials(recordings, HERE)


def test_one_slipping_trial_is_too_few() -> None:
    features = [np.ones((5, 2))] * 2
    labels = [np.array([0, 1, 0, 0, 1], bool), np.zeros(5, bool)]
    with pytest.raises(DatasetError, match="one class"):
        leave_one_out(features, labels, [np.ones(5, bool)] * 2, HERE)


@pytest.mark.real
@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no real recordings at {FOLDER}")
def test_real_trials_are_what_the_report_says(tokenizer: Tokenizer) -> None:
    trials = read_trials(FOLDER)
    assert len(trials) == 7 and sum(t.reference_from == "own" for t in trials) == 2
    assert sum(bool(t.slip.any()) for t in trials) == 3 and sum(len(starts(t.slip)) for t in trials) == 4
    assert sum(t.load_range_counts > SlipConfig().load_change_counts for t in trials) == 4
    short = replace(trials[-1], counts=trials[-1].counts[:, 100:160])
    signals = encode_trial(tokenizer, short)
    assert signals.saturated_frames == 0 and np.isfinite(signals.latent).all()
    total = signals.counts[..., 2].sum(axis=2)
    assert balance(*total, np.ones(60, bool))["r_whole"] > 0.9


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


def mixed(seed: int, gain: float = 1.0, noise: float = 0.3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return latents (30, 4, 6), forces (30, 4, 3), and the (6, 6) basis whose first axes carry force."""
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))[0]
    rng = np.random.default_rng(seed)
    force = rng.uniform(-3, 3, (30, 4, 3))
    on_axes = np.concatenate([gain * force, rng.standard_normal((30, 4, 3))], axis=-1)
    on_axes = on_axes + noise * rng.standard_normal(on_axes.shape)
    return on_axes @ basis.T, force, basis


def abs_r(z: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Return (3,) |r| of the first three axes with their own force."""
    return np.array([abs(np.corrcoef(z[..., i].ravel(), force_N[..., i].ravel())[0, 1]) for i in range(3)])


def test_rotation_is_orthogonal_and_finds_the_directions_of_force_on_unseen_data() -> None:
    z, force, basis = mixed(1)
    rotation = fit_rotation(z, force, "here")
    np.testing.assert_allclose(rotation.matrix.T @ rotation.matrix, np.eye(6), atol=1e-9)
    assert np.linalg.det(rotation.matrix) == pytest.approx(1)
    assert ((rotation.matrix[:, :3] * basis[:, :3]).sum(axis=0) > 0.98).all()
    other, truth, _ = mixed(2, gain=2.0)
    assert (abs_r(rotation(other), truth) > 0.98).all()


def test_a_weak_force_beside_strong_ones_is_found_too() -> None:
    """Strong shear lies askew to the weak normal force: the nearest triple to the regression directions loses it."""
    rng = np.random.default_rng(3)
    force = rng.uniform(-3, 3, (60, 8, 3))
    carries = np.array([[1.0, 0, 0, 0.3, 0, 0], [0, 1.0, 0, 0, 0.3, 0], [0.1, 0.1, 0.05, 0, 0, 0.01]])
    z = force @ carries + 0.002 * rng.standard_normal((60, 8, 6))
    assert (abs_r(fit_rotation(z[:30], force[:30], "here")(z[30:]), force[30:]) > 0.9).all()


def test_rotation_fitted_to_shuffled_labels_finds_nothing() -> None:
    z, force, _ = mixed(1)
    wrong = fit_rotation(z, np.random.default_rng(0).permutation(force), "nowhere")
    other, truth, _ = mixed(2)
    assert abs_r(wrong(other), truth).mean() < 0.7


@pytest.mark.parametrize(("spoil", "says"), [("nan", "NaN"), ("shape", "finite"), ("flat", "three directions")])
def test_bad_input_raises(spoil: str, says: str) -> None:
    z, force, _ = mixed(6)
    if spoil == "nan":
        z[0, 0, 0] = np.nan
    elif spoil == "shape":
        force = force[:, :3]
    else:
        z = np.ones_like(z)
    with pytest.raises(ContractError, match=says):
        fit_rotation(z, force, "here")
