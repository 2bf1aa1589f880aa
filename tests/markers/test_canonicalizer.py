"""The class: one contract for every sensor."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from contact_samples import sphere
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.identity import outline, why_not
from uniforce_vtla.markers.reference import capture_taxel_reference
from uniforce_vtla.markers.registration import (
    nominal_zoom,
    points_to_nominal_scale,
    to_nominal_scale,
)
from uniforce_vtla.sensors import get_sensor, list_sensors
from uniforce_vtla.sensors.layouts import rectangular


@pytest.fixture(scope="module", params=list_sensors())
def raw_pair(request):
    """Name, free-air signal and pressed signal of each sensor."""
    simulator = TactileSimulator(request.param)
    pressed = simulator.raw_frames(sphere(1.0, -0.6, 8.0))[0]
    return request.param, simulator.raw_reference(), pressed


def test_every_sensor_gives_the_pair_that_single_calls_give_and_flips_nothing(raw_pair):
    sensor, reference, current = raw_pair
    kept = reference.copy(), current.copy()
    canon = Canonicalizer(sensor)
    canon.set_reference(reference)
    for finger in FINGERS:
        pair = canon.pair(reference, current, finger=finger)
        assert (pair.sensor, pair.finger) == (sensor, finger)
        assert np.array_equal(canon.marker_image(reference), pair.reference)
        assert np.array_equal(canon.marker_image(current), pair.current)
        assert pair.current.shape == (480, 640)
        assert not np.array_equal(pair.reference, pair.current)
    assert np.array_equal(reference, kept[0]) and np.array_equal(current, kept[1])


def test_markers_match_the_layout(raw_pair):
    sensor, reference, current = raw_pair
    canon = Canonicalizer(sensor)
    canon.set_reference(reference)
    centres = canon.markers(current)
    assert centres.dtype == np.float32 and centres.shape == get_sensor(sensor).layout_mm.shape
    assert np.all((centres >= 0) & (centres < (640, 480)))


@pytest.mark.parametrize("sensor", ["digit", "", "TacTip", None])
def test_unknown_sensor(sensor):
    with pytest.raises(SensorError, match=r"gelsight \| tactip \| uskin"):
        Canonicalizer(sensor)


# --- the seven real uSkin trials ------------------------------------------------------------------

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
    free = {}
    for name in DROPPED:
        scans = uskin_scans(trials[0].parent / name / log)
        free[name] = capture_taxel_reference(scans[-FREE_SCANS:])
    canon = Canonicalizer("uskin")
    for trial in trials:
        reference = free.get(trial.name, free[DROPPED[1]])
        white = []
        for scan in uskin_scans(trial / log):
            pair = canon.pair(reference, scan, finger)
            white.append((pair.current > 0).sum())
        # the grasp holds from the start
        assert white[0] > 3 * (pair.reference > 0).sum()
        assert (white[0] > 3 * white[-1]) == (trial.name in DROPPED)


@pytest.mark.parametrize("name", list_sensors())
def test_the_known_sensors_stay_as_they_are(name):
    image = np.zeros((480, 640), np.uint8)
    assert to_nominal_scale(image, get_sensor(name)) is image


@pytest.mark.parametrize(
    "name, px_per_mm", [("gelsight", 15.0), ("gelsight", 30.0), ("tactip", 14.0)]
)
def test_another_lens_over_the_same_gel_looks_nominal(name, px_per_mm):
    nominal = as_virtual(name)
    spec = replace(nominal.spec, px_per_mm=(px_per_mm, px_per_mm))
    other = TactileSimulator(replace(nominal, spec=spec)).reference()
    brought = to_nominal_scale(other, spec)
    wanted = TactileSimulator(nominal).reference()
    assert set(np.unique(brought)) == {0, 255}
    # what a near lens cut away can't come back
    other, brought, wanted = np.stack([other, brought, wanted])[:, 100:380, 140:500] > 0
    both = (brought & wanted).sum()
    assert both / (brought | wanted).sum() > 0.75
    assert both > 1.5 * (other & wanted).sum()


@examples(30)
@given(
    zoom=st.floats(0.6, 1.7), x=st.integers(250, 390), y=st.integers(180, 300), taxel=st.booleans()
)
def test_a_marker_goes_where_its_point_goes(zoom, x, y, taxel):
    base = get_sensor("uskin" if taxel else "gelsight")
    spec = replace(base, px_per_mm=(24.0 / zoom, 24.0 / zoom))
    image = np.zeros((480, 640), np.uint8)
    image[y - 6 : y + 7, x - 6 : x + 7] = 255
    moved = np.argwhere(to_nominal_scale(image[None], spec)[0])
    point = points_to_nominal_scale(np.array([[x, y]], np.float32), spec, image.shape)[0]
    assert np.allclose(moved.mean(axis=0)[::-1], point, atol=1.0)
    assert nominal_zoom(spec) == pytest.approx((1.0, 1.0) if taxel else (zoom, zoom))


def test_the_canonicalizer_brings_a_new_cameras_images_to_scale():
    raw = TactileSimulator("gelsight", seed=0).raw_reference()
    plain = Canonicalizer("gelsight")
    zoomed = Canonicalizer("gelsight")
    # as a registry entry with another lens would
    zoomed.spec = replace(zoomed.spec, px_per_mm=(20.0, 20.0))
    image = plain.marker_image(raw)
    again = zoomed.marker_image(raw)
    assert np.array_equal(again, to_nominal_scale(image, zoomed.spec))
    assert not np.array_equal(image, again)
    # with a reference the scale is measured
    one, other = (c.pair(raw, raw, "left").current > 0 for c in (plain, zoomed))
    assert (one & other).sum() > 0.95 * one.sum()
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
    assert abs(outline(rectangular(9, 12, (1, 1))) - 1.6) < 0.13


@pytest.mark.real
def test_a_real_gelsight_is_one_and_no_tactip(real_folder):
    frame = cv2.imread(str(real_folder / "gelsight_fots" / "0.png"))
    centres = Canonicalizer("gelsight").markers(frame[..., ::-1].copy())
    assert why_not(get_sensor("gelsight"), centres, "it") is None
    assert why_not(get_sensor("tactip"), centres, "it") is not None
