"""Sensors that exist only in simulation: drawings and shapes."""

import numpy as np
import pytest
from contact_samples import faces

from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.errors import SensorError
from uniforce_vtla.sensors import list_sensors


def press(n=4):
    return faces([(2.0, -1.0, 8.0)] * n, side_mm=10.0)


@pytest.mark.parametrize("name", list_sensors())
def test_a_registry_sensor_by_name_or_as_virtual_is_the_same(name):
    images = [TactileSimulator(s, seed=1).marker_images(press()) for s in (name, as_virtual(name))]
    assert np.array_equal(*images)


def test_unknown_names_are_refused():
    with pytest.raises(SensorError, match="nonsense"):
        as_virtual("nonsense")


def test_a_look_changes_the_picture_but_nothing_hidden():
    unit = UnitVariation.draw(np.random.default_rng(0), "gelsight")
    seen = unit.seen_through(np.random.default_rng(1), Look())
    assert (seen.stiffness, seen.gain, seen.seed) == (unit.stiffness, unit.gain, unit.seed)
    pictures = [TactileSimulator("gelsight", u).reference() for u in (unit, seen)]
    assert not np.array_equal(*pictures)


def test_tilt_magnifies_one_side():
    tilted, straight = (
        TactileSimulator("gelsight", unit).markers_px(press(1))[0][0, :, 0]
        for unit in (UnitVariation(tilt=(0.1, 0.0)), UnitVariation())
    )
    outermost = [straight.argmin(), straight.argmax()]
    assert (tilted - straight)[outermost].min() > 5
