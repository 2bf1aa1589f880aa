"""A fifth sensor: points with displacements in 3D, and no picture."""

import numpy as np
import pytest
from contact_samples import sphere

from uniforce_vtla import Canonicalizer
from uniforce_vtla.contact import ContactOptions, TactileSimulator
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.sensors import get_sensor

PLACE_mm = get_sensor("tac3d").points.place_mm
FREE = np.random.default_rng(0).normal(0, 0.005, (400, 3)).astype(np.float32)


@pytest.fixture
def tac3d():
    canonicalizer = Canonicalizer("tac3d")
    canonicalizer.set_reference(FREE)
    return canonicalizer


def growth(tac3d, moved_mm):
    """Return how much more white there is than in free air."""
    now, free = ((tac3d.marker_image(raw) > 0).sum() for raw in (FREE + moved_mm, FREE))
    return now / free


def test_points_moved_aside_are_markers_moved_aside_and_points_pressed_in_look_larger(tac3d):
    aside = tac3d.markers(FREE + np.array([0.5, -0.25, 0.0])) - tac3d.markers(FREE)
    assert np.allclose(aside, (12.0, -6.0), atol=1e-3)  # y down
    assert 1.02 < growth(tac3d, (0, 0, 1.0)) < 1.12


def test_one_point_moves_its_marker_by_a_quarter_and_points_that_part_make_markers_grow(tac3d):
    raw = FREE.copy()
    raw[0, 0] += 0.4
    aside = tac3d.markers(raw) - tac3d.markers(FREE)
    assert np.allclose(aside[0], (2.4, 0.0), atol=1e-3) and not aside[1:].any()
    parted_mm = 0.05 * np.pad(PLACE_mm, ((0, 0), (0, 1)))
    assert 1.06 < growth(tac3d, parted_mm) < 1.14  # 5 % longer each way


@pytest.mark.parametrize(
    "raw", [FREE[:, :2], FREE.astype(np.int32), FREE + np.nan, FREE + 30, None]
)
def test_what_is_no_displacement_breaks_the_contract(raw):
    with pytest.raises(ContractError, match="tac3d reference: expected"):
        Canonicalizer("tac3d").set_reference(raw)


def test_a_dead_stream_and_a_pressed_reference_are_refused():
    with pytest.raises(SensorError, match="a live scan"):
        Canonicalizer("tac3d").set_reference(np.zeros((400, 3)))
    pressed = TactileSimulator("tac3d").raw_frames(sphere(0, 0, 3.0))[0]
    with pytest.raises(SensorError, match="in contact"):
        Canonicalizer("tac3d").pair(pressed, FREE, "left")


def test_simulated_raw_points_are_drawn_as_the_simulator_draws_them():
    simulator = TactileSimulator("tac3d", options=ContactOptions().quiet())
    contact = sphere(1.0, -1.0, 6.0)
    raw = simulator.raw_frames(contact)[0]
    assert raw.shape == (400, 3) and raw[:, 2].max() > 0.1
    assert raw[:, 0].mean() > 0 > raw[:, 1].mean()
    free = np.full((400, 3), 1e-9)  # noiseless, and not dead
    drawn = Canonicalizer("tac3d").pair(free, raw, "left").current
    assert np.array_equal(drawn, simulator.marker_images(contact)[0])
