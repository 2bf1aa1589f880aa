"""A fifth sensor: points with displacements in 3D, and no picture."""

import numpy as np
import pytest
from contact_samples import sphere

from uniforce_vtla import Canonicalizer, ForceHead, Tokenizer
from uniforce_vtla.contact import ContactOptions, TactileSimulator
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.sensors import get_sensor

PLACE_mm = get_sensor("tac3d").points.place_mm
FREE = np.random.default_rng(0).normal(0, 0.005, (400, 3)).astype(np.float32)


def moved(*mm):
    return FREE + np.array(mm, np.float32)


def markers_px(raw):
    canonicalizer = Canonicalizer("tac3d")
    canonicalizer.set_reference(FREE)
    return canonicalizer.markers(raw)


def white(raw):
    return int((Canonicalizer("tac3d").pair(FREE, raw, finger="left").current > 0).sum())


def test_points_moved_aside_are_markers_moved_aside_and_points_pressed_in_look_larger():
    aside = markers_px(moved(0.5, -0.25, 0.0)) - markers_px(FREE)
    assert np.allclose(aside, (12.0, -6.0), atol=1e-3)  # y down
    assert 1.02 < white(moved(0, 0, 1.0)) / white(FREE) < 1.12


def test_one_point_moves_its_marker_by_a_quarter_and_points_that_part_make_markers_grow():
    raw = FREE.copy()
    raw[0, 0] += 0.4
    aside = markers_px(raw) - markers_px(FREE)
    assert np.allclose(aside[0], (2.4, 0.0), atol=1e-3) and not aside[1:].any()
    parted = FREE + np.float32(0.05) * np.pad(PLACE_mm, ((0, 0), (0, 1)))
    assert 1.06 < white(parted) / white(FREE) < 1.14  # 5 % longer each way


@pytest.mark.parametrize(
    "raw", [FREE[:, :2], FREE.astype(np.int32), FREE[:16], FREE + np.nan, FREE + 30, None]
)
def test_what_is_no_displacement_breaks_the_contract(raw):
    with pytest.raises(ContractError, match="tac3d reference: expected"):
        Canonicalizer("tac3d").set_reference(raw)


def test_a_dead_stream_and_a_pressed_reference_are_refused():
    with pytest.raises(SensorError, match="a live scan"):
        Canonicalizer("tac3d").set_reference(np.zeros((400, 3)))
    with pytest.raises(SensorError, match="in contact"):
        Canonicalizer("tac3d").pair(moved(0, 0, 0.3), FREE, finger="left")
    simulator = TactileSimulator("tac3d")
    with pytest.raises(SensorError, match="in contact"):
        Canonicalizer("tac3d").pair(
            simulator.raw_frames(sphere(0, 0, 3.0))[0], simulator.raw_reference(), "left"
        )


def test_simulated_raw_points_are_drawn_as_the_simulator_draws_them():
    simulator = TactileSimulator("tac3d", options=ContactOptions().quiet())
    contact = sphere(1.0, -1.0, 6.0)
    raw = simulator.raw_frames(contact)[0]
    assert raw.shape == (400, 3) and raw[:, 2].max() > 0.1
    assert raw[:, 0].mean() > 0 > raw[:, 1].mean()
    free = np.full((400, 3), 1e-9)  # noiseless, and not dead
    drawn = Canonicalizer("tac3d").pair(free, raw, "left").current
    assert np.array_equal(drawn, simulator.marker_images(contact)[0])


def test_a_head_of_another_sensor_reads_its_grip_and_shear():
    simulator = TactileSimulator("tac3d")
    tokenizer = Tokenizer.from_pretrained()
    head = ForceHead.from_pretrained("gelsight")
    free = simulator.raw_reference()
    loads = ((0.0, 0.0, 3.0), (2.0, 0.0, 6.0), (0.0, 2.0, 10.0))
    read_N = []
    for load in loads:
        pair = Canonicalizer("tac3d").pair(free, simulator.raw_frames(sphere(*load))[0], "left")
        read_N.append(head(tokenizer.encode(pair))[0].numpy())
    assert np.allclose(read_N, loads, atol=4)
    assert np.corrcoef(np.ravel(read_N), np.ravel(loads))[0, 1] > 0.9
