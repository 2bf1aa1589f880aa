"""A camera mounted askew shows the drawing's pattern where the drawing has it; another pattern
stays where it is."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from uniforce_vtla.contact import TactileSimulator, UnitVariation
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.registration import drawn_px, find_view, seen_from
from uniforce_vtla.sensors import get_sensor

ASKEW = UnitVariation(
    view_shift_mm=(0.9, -0.7), view_turn_rad=0.09, view_scale=1.05, tilt=(0.03, -0.02)
)
CAMERAS = pytest.mark.parametrize("sensor", ["gelsight", "tactip"])
TACTIP = get_sensor("tactip")


def seen_px(spec, unit=ASKEW):
    return TactileSimulator(spec.name, unit)._project(spec.layout_mm[None])[0]


def off_px(seen, view, spec):
    """Return how far markers that are moved by a view lie from the drawing's."""
    moved = np.c_[seen, np.ones(len(seen))] @ view.T
    return np.abs(moved[:, :2] / moved[:, 2:] - drawn_px(spec)).max()


@CAMERAS
def test_markers_come_to_their_places_in_the_drawing(sensor):
    spec = get_sensor(sensor)
    seen = seen_px(spec)
    assert off_px(seen, np.eye(3), spec) > 20
    assert off_px(seen, find_view(seen, spec), spec) < 2.0


@CAMERAS
def test_lost_and_strange_markers_do_not_matter(sensor):
    spec = get_sensor(sensor)
    seen = seen_px(spec)
    strange = np.array([[30.0, 30.0], [610.0, 450.0]])
    assert off_px(seen, find_view(np.concatenate([seen[3:], strange]), spec), spec) < 3.0


def test_a_camera_that_was_mounted_at_an_angle_stays_there():
    assert find_view(seen_px(TACTIP, UnitVariation(view_turn_rad=0.31)), TACTIP) is None


def test_another_pattern_stays_where_it_is():
    assert find_view(drawn_px(TACTIP), get_sensor("gelsight")) is None  # another number
    scattered = np.random.default_rng(0).uniform(0, (640, 480), TACTIP.layout_mm.shape)
    assert find_view(scattered, TACTIP) is None  # no such pattern


@CAMERAS
def test_the_canonicalizer_takes_the_mounting_out_of_raw_frames(sensor):
    straight, askew = (TactileSimulator(sensor, unit) for unit in (UnitVariation(), ASKEW))
    seen = []
    for simulator in (straight, askew):
        canonicalizer = Canonicalizer(sensor)
        canonicalizer.set_reference(simulator.raw_reference())
        seen.append(canonicalizer.marker_image(simulator.raw_reference()))
    assert iou(*seen) > 0.75 > iou(straight.reference(), askew.reference())


def iou(one, two):
    return float(((one > 0) & (two > 0)).sum() / ((one > 0) | (two > 0)).sum())


def test_an_image_is_moved_as_its_points_are():
    view = find_view(seen_px(TACTIP), TACTIP)
    moved = seen_from(TactileSimulator("tactip", ASKEW).reference(), view)
    assert set(np.unique(moved)) == {0, 255}
    rows, columns = np.nonzero(moved)
    off = cKDTree(drawn_px(TACTIP)).query(np.c_[columns, rows])[0]
    assert off.max() < TACTIP.marker_size_mm * TACTIP.px_per_mm[0]
