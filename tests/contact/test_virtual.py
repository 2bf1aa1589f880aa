"""Sensors that exist only in simulation: drawings and shapes."""

import numpy as np
import pytest

from uniforce_vtla.contact.sampling import sample_objects
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import GELSIGHT_D, as_virtual
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import SensorError
from uniforce_vtla.markers.raster import fill_squares
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.sensors.layouts import staggered


def press(n=4):
    gap = sample_objects(np.random.default_rng(0), n, ["cylinder"]).gap_mm
    force = np.tile(np.array([2.0, -1.0, 8.0], np.float32), (n, 1))
    return ContactState(gap, force, np.zeros(n, np.float32))


@pytest.mark.parametrize("name", list_sensors())
def test_a_registry_sensor_by_name_or_as_virtual_is_the_same(name):
    images = [TactileSimulator(s, seed=1).marker_images(press()) for s in (name, as_virtual(name))]
    assert np.array_equal(*images)


def test_unknown_names_are_refused():
    with pytest.raises(SensorError, match="nonsense"):
        as_virtual("nonsense")


def test_diamonds_are_squares_on_their_corner():
    image = TactileSimulator(GELSIGHT_D).reference()
    centre = np.full((1, 1, 2), 100.0)
    diamond = fill_squares(centre, np.full((1, 1), 40.0), np.pi / 4)[0]
    rows, columns = np.nonzero(diamond)
    assert np.ptp(rows) > 1.3 * 40 and np.ptp(columns) > 1.3 * 40
    assert abs(np.count_nonzero(diamond) - 1600) < 60 and image.any()


def test_layouts():
    assert len(staggered(3, 4, (1.0, 1.0))) == 4 + 3 + 4


def test_a_look_changes_the_picture_but_nothing_hidden():
    unit = UnitVariation.draw(np.random.default_rng(0), "gelsight")
    seen = unit.seen_through(np.random.default_rng(1), Look())
    assert (seen.stiffness, seen.gain, seen.seed) == (unit.stiffness, unit.gain, unit.seed)
    pictures = [TactileSimulator("gelsight", u).reference() for u in (unit, seen)]
    assert not np.array_equal(*pictures)


def test_tilt_magnifies_one_side():
    unit = UnitVariation(tilt=(0.1, 0.0))
    centre, _ = TactileSimulator("gelsight", unit).markers_px(press(1))
    straight, _ = TactileSimulator("gelsight").markers_px(press(1))
    right, left = straight[0, :, 0].argmax(), straight[0, :, 0].argmin()
    assert (
        centre[0, right, 0] > straight[0, right, 0] + 5
        and centre[0, left, 0] > straight[0, left, 0] + 5
    )
