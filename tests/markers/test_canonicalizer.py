"""The class: one contract for every sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed.canonicalizer import bench_canonicalizer, synthetic_frame
from uniforce_vtla.contracts import check_marker_image
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.reference import capture_taxel_reference
from uniforce_vtla.sensors import get_sensor, list_sensors
from uniforce_vtla.sensors.uskin_csv import read_uskin_csv

COUNTS = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))


def raw_pair(sensor: str) -> tuple[np.ndarray, np.ndarray]:
    if get_sensor(sensor).signal == "taxel":
        return COUNTS, COUNTS + np.array([50, -30, 800])
    rng = np.random.default_rng(0)
    return tuple(synthetic_frame(get_sensor(sensor), rng, shift_px=shift) for shift in (0.0, 3.0))


@pytest.mark.parametrize("sensor", list_sensors())
def test_every_sensor_gives_a_pair(sensor):
    reference, current = raw_pair(sensor)
    pair = Canonicalizer(sensor).pair(reference, current, finger="right", reference_from="trial 3")
    assert pair.sensor == sensor and pair.finger == "right" and pair.reference_from == "trial 3"
    for image in (pair.reference, pair.current):
        assert image.shape == (480, 640)
        check_marker_image(image)
    assert not np.array_equal(pair.reference, pair.current)


@pytest.mark.parametrize("sensor", list_sensors())
def test_pair_is_what_the_single_calls_give(sensor):
    reference, current = raw_pair(sensor)
    canon = Canonicalizer(sensor)
    canon.set_reference(reference)
    pair = canon.pair(reference, current, finger="left")
    assert np.array_equal(canon.marker_image(reference), pair.reference)
    assert np.array_equal(canon.marker_image(current), pair.current)


@pytest.mark.parametrize("sensor", list_sensors())
def test_nothing_is_flipped_and_inputs_stay_as_they_were(sensor):
    reference, current = raw_pair(sensor)
    kept = reference.copy(), current.copy()
    left, right = (Canonicalizer(sensor).pair(reference, current, finger=f) for f in ("left", "right"))
    assert np.array_equal(left.current, right.current)
    assert np.array_equal(reference, kept[0]) and np.array_equal(current, kept[1])


@pytest.mark.parametrize("sensor", list_sensors())
def test_markers_match_the_layout(sensor):
    canon = Canonicalizer(sensor)
    canon.set_reference(raw_pair(sensor)[0])
    centres = canon.markers(raw_pair(sensor)[1])
    assert centres.dtype == np.float32 and centres.shape == get_sensor(sensor).layout_mm.shape
    assert np.all((centres >= 0) & (centres < (640, 480)))


@pytest.mark.parametrize("sensor", list_sensors())
def test_version_and_scales_can_be_stored(sensor):
    canon = Canonicalizer(sensor)
    assert canon.version and canon.scales["version"] == canon.version


def test_a_changed_reference_frame_is_not_mistaken_for_the_last(gel):
    canon, frame = Canonicalizer("gelsight"), gel().frame.copy()
    canon.pair(frame, frame, finger="left")
    frame[:] = gel(grid=(5, 5)).frame
    assert np.array_equal(
        canon.pair(frame, frame, finger="left").reference, Canonicalizer("gelsight").marker_image(frame)
    )


@pytest.mark.parametrize("sensor", ["digit", "", "TacTip", None])
def test_unknown_sensor(sensor):
    with pytest.raises(SensorError, match=r"gelsight \| tactip \| uskin"):
        Canonicalizer(sensor)


def test_unknown_finger():
    with pytest.raises(ContractError, match="finger"):
        Canonicalizer("uskin").pair(COUNTS, COUNTS, finger="thumb")


def test_bench_reports_every_sensor_and_its_anchor():
    report = bench_canonicalizer(seconds=0.3)
    assert set(report["canonicalize_hz"]) == set(list_sensors())
    assert all(rate > 5 for rate in report["canonicalize_hz"].values())
    assert report["anchors"]["adaptive_threshold_hz"] > report["canonicalize_hz"]["gelsight"]


# --- the seven real uSkin trials -----------------------------------------------------------------------------------

DROPPED = ("data_sample_2022-02-22-08-10-01", "data_sample_2022-02-22-15-15-00")
FREE_SCANS = 10  # the last ones, after the object has dropped


@pytest.mark.real
@pytest.mark.parametrize("log, finger", [("xela_sensor1.csv", "left"), ("xela_sensor2.csv", "right")])
def test_all_real_trials_are_rendered(real_folder: Path, log: str, finger: str):
    trials = sorted((real_folder / "uskin_bilateral_slip" / "data_set").iterdir())
    assert len(trials) == 7
    lender = trials[0].parent / DROPPED[1]
    borrowed = capture_taxel_reference(read_uskin_csv(lender / log)[-FREE_SCANS:])
    for trial in trials:
        scans = read_uskin_csv(trial / log)
        own = trial.name in DROPPED
        reference = capture_taxel_reference(scans[-FREE_SCANS:]) if own else borrowed
        canon = Canonicalizer("uskin")
        label = "own" if own else f"borrowed from {lender.name}"
        pairs = [canon.pair(reference, scan, finger, reference_from=label) for scan in scans]
        assert canon.saturation.frames == len(scans) == len(pairs)
        assert canon.saturation.frames_saturated == 0  # these grasps stay below 5,900 counts
        assert all(pair.reference_from == label for pair in pairs)
        assert (pairs[0].current > 0).sum() > (pairs[0].reference > 0).sum()  # the grasp holds from the start


@pytest.mark.real
def test_free_air_and_held_scans_look_different(real_folder: Path):
    scans = read_uskin_csv(
        real_folder / "uskin_bilateral_slip" / "data_set" / DROPPED[1] / "xela_sensor1.csv"
    )
    reference = capture_taxel_reference(scans[-FREE_SCANS:])
    canon = Canonicalizer("uskin")
    canon.set_reference(reference)
    held, free = ((canon.marker_image(scan) > 0).sum() for scan in (scans[0], scans[-1]))
    assert held > 3 * free
