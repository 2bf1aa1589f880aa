"""Runs of a magnetic skin in their authors' form: what is read, what is fitted to what, what stays
sealed."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.real.__main__ import main
from benchmarks.real.eflesh import (
    GRAM_N,
    NORMAL,
    SEALED,
    SHEAR,
    absolute_errors,
    cases_of,
    eflesh_lines,
    eflesh_rows,
    marker_images,
    on_the_pad,
    read_run,
    read_runs,
    weighed,
)
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.tokenizer import Tokenizer

REAL = Path(__file__).parents[2].parent / "shared" / "real" / "eflesh"
FIELD = np.random.default_rng(0).normal(size=15)  # µT of one unit per gram


def write_run(folder, units, rows=120):
    """Press from 0 to 1,800 g and back, three times; the second unit answers by .7; every sixth
    force is missing."""
    folder.mkdir(parents=True)
    gram = 900 - 900 * np.cos(6 * np.pi * np.arange(rows) / (rows - 1))
    time_s = np.arange(rows) / 15
    field = np.column_stack([time_s, np.kron([1.0, 0.7][:units], np.outer(gram, FIELD))])
    said = np.where(np.arange(rows) % 6 == 5, -1, gram)
    state = np.column_stack([time_s, np.zeros((rows, 3)), said])
    np.savetxt(folder / "sensor_post_baselines.csv", field, delimiter=",")
    np.savetxt(folder / "states.csv", state, delimiter=",")
    return folder


@pytest.fixture
def recorded(tmp_path):
    for name in ("1_probe", "2_probe", SEALED[NORMAL]):
        write_run(tmp_path / NORMAL / name, units=1, rows=480)
    for name in ("3_probe", SEALED[SHEAR]):
        write_run(tmp_path / SHEAR / name, units=2, rows=480)
    return tmp_path


def test_missing_forces_are_left_out_and_grams_become_newtons(tmp_path):
    run = read_run(write_run(tmp_path / "a_probe", units=2), SHEAR, 1000)
    assert run.counts.shape == (100, 2, 5, 3)
    assert run.force_N.min() == 0.0
    assert run.force_N.max() == pytest.approx(1800 * GRAM_N, rel=0.01)
    field = run.counts[:, 0].reshape(100, 15)
    assert np.allclose(field, np.outer(run.force_N / GRAM_N, FIELD), atol=1e-6)
    assert len(read_run(tmp_path / "a_probe", SHEAR, 30).force_N) == 30


def read(folder, frames=1000, sealed=False):
    """Return the runs, what is fitted to what, and raw features and forces by run."""
    runs = read_runs(folder, frames, sealed)
    seen = {run.name: run.counts.reshape(*run.counts.shape[:2], 15) for run in runs}
    return runs, cases_of(runs, sealed), (seen, {run.name: run.force_N for run in runs})


def test_sealed_runs_are_read_when_asked_for_alone(recorded):
    opened, cases, _ = read(recorded)
    assert [run.name for run in opened] == ["1_probe", "2_probe", "3_probe"]
    for case in cases:
        assert case.fit != case.read and case.known != case.read
    both, cases, _ = read(recorded, sealed=True)
    assert {run.name for run in both} - {run.name for run in opened} == {*SEALED.values()}
    for case in cases:
        assert case.read.run in SEALED.values() and case.fit.run not in SEALED.values()
        assert case.known is None or case.known.run not in SEALED.values()
    assert [case.name for case in cases].count("own head, normal") == 2


def test_open_halves_of_a_run_do_not_overlap(recorded):
    _, cases, _ = read(recorded)
    shear = [case for case in cases if "normal" not in case.name]
    assert len(shear) == 4
    for case in shear:
        assert case.fit.rows.stop == case.read.rows.start == 200
        assert case.known is None or (case.known.unit == case.read.unit != case.fit.unit)


def test_chips_are_turned_to_the_pads_axes():
    """A field to the right, as each chip says it, comes out to the right; a normal field's sign is
    left out."""
    said = np.array([[[0, 3, -2], [0, 3, 2], [-3, 0, -2], [0, -3, 2], [3, 0, 2]]], float)
    assert np.allclose(on_the_pad(said), np.tile([3.0, 0.0, 2.0], (1, 5, 1)))


def test_discs_move_and_grow_with_the_field():
    rest, pressed = marker_images(np.array([np.zeros((5, 3)), np.full((5, 3), 300.0)]))
    assert rest.shape == (480, 640) and set(np.unique(rest)) == {0, 255}
    assert pressed.sum() > 5 * rest.sum() > 0


def test_a_unit_that_answers_less_is_weighed(recorded):
    _, cases, seen = read(recorded)
    other = next(case for case in cases if case.known and case.known.unit == 1)
    errors = absolute_errors(other, *seen, 0.01)
    assert errors["other unit's head"].mean() > 2.0
    assert errors["three loads"].mean() < 0.05 and errors["ten frames"].mean() < 0.05


def test_loads_that_were_never_pressed_are_named():
    known_N = np.linspace(0, 9, 100)
    with pytest.raises(DatasetError, match="got none near 10, 15 N"):
        weighed(known_N, known_N, known_N)


@pytest.mark.parametrize("damage", ["gone", "short", "words"])
def test_damaged_tables_are_refused(damage, tmp_path):
    folder = write_run(tmp_path / "a_probe", units=1)
    states = folder / "states.csv"
    lines = states.read_text().splitlines()
    if damage == "gone":
        states.unlink()
    else:
        states.write_text("\n".join(lines[:50] if damage == "short" else ["a,b,c,d,e", *lines[1:]]))
    with pytest.raises(DatasetError, match="Copy the run again"):
        read_run(folder, NORMAL, 1000)


def test_a_folder_without_the_sealed_runs_says_which(recorded):
    shutil.rmtree(recorded / NORMAL / SEALED[NORMAL])
    with pytest.raises(DatasetError, match=SEALED[NORMAL]):
        read_runs(recorded, 1000, sealed=True)
    with pytest.raises(DatasetError, match="notvenky/eFlesh"):
        read_runs(recorded / NORMAL, 1000, sealed=False)


@pytest.mark.parametrize("sealed", [False, True])
def test_every_row_has_every_way_of_reading(recorded, tiny, sealed):
    found = eflesh_rows(recorded, Tokenizer.random(tiny), 1, 400, sealed)
    mae = found["mae_N"]
    assert list(mae) == ["tokenizer", "untrained", "raw counts", "tokenizer − raw counts"]
    ways = {"own head, normal", "own head, shear", "other unit's head", "three loads", "ten frames"}
    for by_ridge in mae.values():
        assert {way for by_way in by_ridge.values() for way in by_way} == ways
    difference = mae["tokenizer − raw counts"]["1.0"]["three loads"]
    by_hand = mae["tokenizer"]["1.0"]["three loads"] - mae["raw counts"]["1.0"]["three loads"]
    assert difference["mean"] == pytest.approx(by_hand, abs=0.05)
    assert difference["interval_95"][0] <= difference["mean"] <= difference["interval_95"][1]
    lines = eflesh_lines(found)
    assert "grams are assumed" in lines[0] and len(lines) == 9
    assert lines[0].endswith("sealed" if sealed else "development")


def test_raw_counts_read_a_real_run_of_the_same_unit():
    if not REAL.is_dir():
        pytest.skip(f"no real recordings at {REAL}")
    _, cases, seen = read(REAL, 500)
    own = [case for case in cases if case.name.startswith("own")]
    assert len(own) == 4
    for case in own:
        assert absolute_errors(case, *seen, 1.0)[case.name].mean() < 1.0


def test_nothing_named_is_refused(refuses):
    refuses(main, [], "Name those that fit")
