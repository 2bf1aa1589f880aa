"""The class: one contract for every sensor."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.standins.scene import Scene, frame_cycle
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.contracts import check_marker_image
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.identity import outline, why_not
from uniforce_vtla.markers.reference import capture_taxel_reference
from uniforce_vtla.markers.registration import (
    is_nominal,
    nominal_zoom,
    points_to_nominal_scale,
    to_nominal_scale,
)
from uniforce_vtla.sensors import get_sensor, list_sensors

COUNTS = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))


def raw_pair(sensor):
    if get_sensor(sensor).points:
        free = np.random.default_rng(0).normal(0, 0.005, get_sensor(sensor).raw_shape)
        return free, free + np.array([0.3, -0.2, 0.5])
    if get_sensor(sensor).signal == "taxel":
        free = COUNTS if sensor == "uskin" else np.zeros(get_sensor(sensor).raw_shape, int)
        return free, free + (
            np.array([50, -30, 800]) / get_sensor(sensor).taxels.worth
        ).round().astype(int)
    free, _, pressed = frame_cycle(sensor, Scene(rest_s=0.1, press_s=0.2), 10.0)
    return free, pressed


@pytest.mark.parametrize("sensor", list_sensors())
def test_every_sensor_gives_the_pair_that_single_calls_give_and_flips_nothing(sensor):
    reference, current = raw_pair(sensor)
    kept = reference.copy(), current.copy()
    canon = Canonicalizer(sensor)
    canon.set_reference(reference)
    for finger in ("left", "right"):
        pair = canon.pair(reference, current, finger=finger)
        assert (pair.sensor, pair.finger) == (sensor, finger)
        assert np.array_equal(canon.marker_image(reference), pair.reference)
        assert np.array_equal(canon.marker_image(current), pair.current)
        for image in (pair.reference, pair.current):
            assert image.shape == (480, 640)
            check_marker_image(image)
        assert not np.array_equal(pair.reference, pair.current)
    assert np.array_equal(reference, kept[0]) and np.array_equal(current, kept[1])


@pytest.mark.parametrize("sensor", list_sensors())
def test_markers_match_the_layout(sensor):
    canon = Canonicalizer(sensor)
    canon.set_reference(raw_pair(sensor)[0])
    centres = canon.markers(raw_pair(sensor)[1])
    assert centres.dtype == np.float32 and centres.shape == get_sensor(sensor).layout_mm.shape
    assert np.all((centres >= 0) & (centres < (640, 480)))


@pytest.mark.parametrize("sensor", ["digit", "", "TacTip", None])
def test_unknown_sensor(sensor):
    with pytest.raises(SensorError, match=r"gelsight \| tactip \| uskin"):
        Canonicalizer(sensor)


def test_unknown_finger():
    with pytest.raises(ContractError, match="finger"):
        Canonicalizer("uskin").pair(COUNTS, COUNTS, finger="thumb")


# --- the seven real uSkin trials -----------------------------------------------------------------------------------

DROPPED = ("data_sample_2022-02-22-08-10-01", "data_sample_2022-02-22-15-15-00")
FREE_SCANS = 10  # the last ones, after the object has dropped


def uskin_scans(path):
    return np.loadtxt(path, delimiter=",", skiprows=1, dtype=np.int64).reshape(-1, 16, 3)


@pytest.mark.real
@pytest.mark.parametrize(
    "log, finger", [("xela_sensor1.csv", "left"), ("xela_sensor2.csv", "right")]
)
def test_all_real_trials_are_rendered(real_folder, log, finger):
    trials = sorted((real_folder / "uskin_bilateral_slip" / "data_set").iterdir())
    assert len(trials) == 7
    lender = trials[0].parent / DROPPED[1]
    borrowed = capture_taxel_reference(uskin_scans(lender / log)[-FREE_SCANS:])
    for trial in trials:
        scans = uskin_scans(trial / log)
        own = trial.name in DROPPED
        reference = capture_taxel_reference(scans[-FREE_SCANS:]) if own else borrowed
        canon = Canonicalizer("uskin")
        pairs = [canon.pair(reference, scan, finger) for scan in scans]
        # the grasp holds from the start
        assert (pairs[0].current > 0).sum() > (pairs[0].reference > 0).sum()


@pytest.mark.real
def test_free_air_and_held_scans_look_different(real_folder):
    scans = uskin_scans(
        real_folder / "uskin_bilateral_slip" / "data_set" / DROPPED[1] / "xela_sensor1.csv"
    )
    reference = capture_taxel_reference(scans[-FREE_SCANS:])
    canon = Canonicalizer("uskin")
    canon.set_reference(reference)
    held, free = ((canon.marker_image(scan) > 0).sum() for scan in (scans[0], scans[-1]))
    assert held > 3 * free


@pytest.mark.parametrize("name", list_sensors())
def test_the_known_sensors_stay_as_they_are(name):
    image = np.random.default_rng(0).choice([0, 255], (480, 640)).astype(np.uint8)
    spec = get_sensor(name)
    assert is_nominal(spec) and to_nominal_scale(image, spec) is image


@pytest.mark.parametrize(
    "name, px_per_mm", [("gelsight", 15.0), ("gelsight", 30.0), ("tactip", 14.0)]
)
def test_another_lens_over_the_same_gel_looks_nominal(name, px_per_mm):
    nominal = as_virtual(name)
    spec = replace(nominal.spec, px_per_mm=(px_per_mm, px_per_mm))
    other = TactileSimulator(replace(nominal, spec=spec), seed=0).reference()
    brought, wanted = to_nominal_scale(other, spec), TactileSimulator(nominal, seed=0).reference()
    assert set(np.unique(brought)) == {0, 255}
    inner = (slice(100, 380), slice(140, 500))  # what a near lens cut away can't come back
    both = np.logical_and(brought[inner] > 0, wanted[inner] > 0).sum()
    either = np.logical_or(brought[inner] > 0, wanted[inner] > 0).sum()
    assert both / either > 0.75
    before = np.logical_and(other[inner] > 0, wanted[inner] > 0).sum()
    assert both > 1.5 * before


@examples(30)
@given(
    zoom=st.floats(0.6, 1.7), x=st.integers(250, 390), y=st.integers(180, 300), taxel=st.booleans()
)
def test_a_marker_goes_where_its_point_goes(zoom, x, y, taxel):
    base = get_sensor("uskin" if taxel else "gelsight")
    spec = replace(base, px_per_mm=(24.0 / zoom, 24.0 / zoom))
    image = np.zeros((480, 640), np.uint8)
    image[y - 6 : y + 7, x - 6 : x + 7] = 255
    rows, columns = np.nonzero(to_nominal_scale(image[None], spec)[0])
    point = points_to_nominal_scale(np.array([[x, y]], np.float32), spec, (480, 640))[0]
    assert np.allclose([columns.mean(), rows.mean()], point, atol=1.0)
    assert nominal_zoom(spec) == ((1.0, 1.0) if taxel else pytest.approx((zoom, zoom)))


def test_the_canonicalizer_brings_a_new_cameras_images_to_scale(monkeypatch):
    simulator = TactileSimulator("gelsight", seed=0)
    raw = simulator.raw_reference()
    plain = Canonicalizer("gelsight")
    zoomed = Canonicalizer("gelsight")
    # as a registry entry with another lens would
    zoomed.spec = replace(zoomed.spec, px_per_mm=(20.0, 20.0))
    image, again = plain.marker_image(raw), zoomed.marker_image(raw)
    assert np.array_equal(again, to_nominal_scale(image, zoomed.spec)) and not np.array_equal(
        image, again
    )
    pairs = [canonicalizer.pair(raw, raw, "left") for canonicalizer in (plain, zoomed)]
    overlap = (pairs[0].current > 0) & (pairs[1].current > 0)
    # with a reference the scale is measured
    assert overlap.sum() > 0.95 * (pairs[0].current > 0).sum()
    spread = [np.ptp(c.markers(raw), axis=0) for c in (plain, zoomed)]
    assert np.allclose(spread[1] / spread[0], 1.2, atol=0.02)


CAMERAS = ("gelsight", "tactip")


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("worn", CAMERAS)
@pytest.mark.parametrize("said", CAMERAS)
def test_each_sensor_is_itself_and_not_the_other(worn, said, seed):
    frame = TactileSimulator(worn, seed=seed).raw_reference()
    centres = Canonicalizer(said).markers(frame)
    reason = why_not(get_sensor(said), centres, "the finger")
    assert (reason is None) == (worn == said)
    assert reason is None or "check_identity=false" in reason


def test_missing_markers_and_a_stray_blob_change_nothing():
    spec = get_sensor("tactip")
    points = spec.layout_mm * np.asarray(spec.px_per_mm)
    rng = np.random.default_rng(0)
    some = points[rng.random(len(points)) > 0.15]
    assert why_not(spec, np.concatenate([some, [[300.0, 220.0]]]), "it") is None
    assert why_not(spec, points[:50], "it") is not None, "half the markers is another sensor"


def test_real_gels_have_a_rectangles_outline():
    rectangle = np.stack(np.meshgrid(np.arange(12), np.arange(9)), -1).reshape(-1, 2).astype(float)
    assert abs(outline(rectangle) - 1.6) < 0.13


@pytest.mark.real
def test_a_real_gelsight_is_one_and_no_tactip(real_folder):
    frame = cv2.imread(str(real_folder / "gelsight_fots" / "0.png"))
    centres = Canonicalizer("gelsight").markers(frame[..., ::-1].copy())
    assert why_not(get_sensor("gelsight"), centres, "it") is None
    assert why_not(get_sensor("tactip"), centres, "it") is not None
