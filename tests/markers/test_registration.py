"""A camera mounted askew shows the drawing's pattern where the drawing has it; another pattern stays where it is."""

from dataclasses import replace

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


def placed(points, view):
    moved = np.c_[points, np.ones(len(points))] @ view.T
    return moved[:, :2] / moved[:, 2:]


@CAMERAS
def test_markers_come_to_their_places_in_the_drawing(sensor):
    spec = get_sensor(sensor)
    seen = TactileSimulator(sensor, ASKEW, seed=0)._project(spec.layout_mm[None])[0]
    view = find_view(seen, spec)
    assert np.abs(seen - drawn_px(spec)).max() > 20
    assert np.abs(placed(seen, view) - drawn_px(spec)).max() < 2.0  # px


@CAMERAS
def test_lost_and_strange_markers_do_not_matter(sensor):
    spec = get_sensor(sensor)
    seen = TactileSimulator(sensor, ASKEW, seed=0)._project(spec.layout_mm[None])[0]
    strange = np.array([[30.0, 30.0], [610.0, 450.0]])
    view = find_view(np.concatenate([seen[3:], strange]), spec)
    assert np.abs(placed(seen, view) - drawn_px(spec)).max() < 3.0


def test_a_camera_that_was_mounted_at_an_angle_stays_there():
    spec = get_sensor("tactip")
    turned = TactileSimulator("tactip", UnitVariation(view_turn_rad=np.radians(18)), seed=0)
    assert find_view(turned._project(spec.layout_mm[None])[0], spec) is None


def test_another_pattern_stays_where_it_is():
    gelsight, tactip = get_sensor("gelsight"), get_sensor("tactip")
    assert find_view(drawn_px(tactip), gelsight) is None  # another number
    rng = np.random.default_rng(0)
    # no such pattern
    assert find_view(rng.uniform((0, 0), (640, 480), (len(tactip.layout_mm), 2)), tactip) is None


@CAMERAS
def test_the_canonicalizer_takes_the_mounting_out_of_raw_frames(sensor):
    spec = get_sensor(sensor)
    straight, askew = (
        TactileSimulator(sensor, unit, seed=0) for unit in (replace(ASKEW, **STRAIGHT), ASKEW)
    )
    seen = []
    for simulator in (straight, askew):
        canonicalizer = Canonicalizer(sensor)
        canonicalizer.set_reference(simulator.raw_reference())
        seen.append(canonicalizer.marker_image(simulator.raw_reference()))
    assert iou(*seen) > 0.75 > iou(straight.reference(), askew.reference()), spec.name


STRAIGHT = {
    "view_shift_mm": (0.0, 0.0),
    "view_turn_rad": 0.0,
    "view_scale": 1.0,
    "tilt": (0.0, 0.0),
}


def iou(one, two):
    return float(((one > 0) & (two > 0)).sum() / ((one > 0) | (two > 0)).sum())


def test_an_image_is_moved_as_its_points_are():
    spec = get_sensor("tactip")
    simulator = TactileSimulator("tactip", ASKEW, seed=0)
    view = find_view(simulator._project(spec.layout_mm[None])[0], spec)
    moved = seen_from(simulator.reference(), view)
    assert set(np.unique(moved)) == {0, 255}
    rows, columns = np.nonzero(moved)
    assert (
        cKDTree(drawn_px(spec)).query(np.c_[columns, rows])[0].max()
        < spec.marker_size_mm * spec.px_per_mm[0]
    )
