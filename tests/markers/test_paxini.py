"""A fourth sensor: 68 taxels that say newtons, at places of their own."""

import numpy as np
import pytest
from contact_samples import sphere

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_vtla import Canonicalizer, ForceHead, Tokenizer
from uniforce_vtla.contact import ContactOptions, TactileSimulator
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.sensors import get_sensor, list_sensors

FREE = np.zeros((68, 3), np.int16)
COUNT_N = 0.1


def loaded(taxel, x=0, y=0, z=0):
    counts = FREE.copy()
    counts[taxel] = (x, y, z)
    return counts


def paxini():
    canonicalizer = Canonicalizer("paxini")
    canonicalizer.set_reference(FREE)
    return canonicalizer


def moved_px(counts):
    return paxini().markers(counts) - paxini().markers(FREE)


def test_datasets_know_the_others_by_the_places_they_had():
    assert list_sensors() == ("gelsight", "tactip", "uskin", "paxini", "tac3d")


def test_its_taxels_lie_as_the_sdk_says_and_apart():
    layout_mm = get_sensor("paxini").layout_mm
    # of the middle, the lowest
    assert layout_mm.shape == (68, 2) and np.allclose(layout_mm[30], (0, 11.58), atol=0.01)
    columns_mm = np.unique(layout_mm[:, 0].round(1))
    assert np.allclose(columns_mm, -columns_mm[::-1])
    apart = np.linalg.norm(layout_mm[:, None] - layout_mm, axis=-1) + 99 * np.eye(68)
    assert apart.min() > 2 and apart.min(axis=1).max() < 4.5


def test_zeros_are_free_air_of_a_tared_sensor():
    pair = paxini().pair(FREE, loaded(34, z=8), finger="left")
    assert np.array_equal(paxini().marker_image(FREE), pair.reference)
    assert (pair.current > 0).sum() > (pair.reference > 0).sum() + 500


def test_a_reference_wants_readings_enough_that_hold_still():
    taken = paxini().free_air([FREE, FREE, loaded(34, z=1), FREE])
    assert np.array_equal(taken, FREE)
    with pytest.raises(ContractError, match="at least"):
        paxini().free_air([FREE])
    with pytest.raises(SensorError, match="steady"):
        paxini().free_air([loaded(34, z=force) for force in (0, 8, 16, 24)])


def test_shear_moves_discs_right_and_up_and_drags_their_neighbours():
    right, up = moved_px(loaded(34, x=4)), moved_px(loaded(34, y=4))
    assert right[34, 0] > 1 and up[34, 1] < -1 and abs(right[34, 1]) < 0.01
    layout_mm = get_sensor("paxini").layout_mm
    far = np.linalg.norm(layout_mm - layout_mm[34], axis=1) > 10
    assert 0.1 < right[33, 0] < right[34, 0] and right[far, 0].max() < 0.05


@pytest.mark.parametrize("counts", [np.zeros((16, 3), int), FREE.astype(float), FREE.ravel(), None])
def test_other_counts_break_the_contract(counts):
    with pytest.raises(ContractError, match="paxini reference: expected integers"):
        Canonicalizer("paxini").set_reference(counts)


def test_a_pressed_reference_is_refused():
    pressed_then = FREE + np.array([0, 0, 5], np.int16)
    with pytest.raises(SensorError, match="in contact"):
        Canonicalizer("paxini").pair(pressed_then, FREE, finger="left")


def test_simulated_taxels_say_together_what_the_pad_carries():
    simulator = TactileSimulator("paxini", options=ContactOptions().quiet())
    contact = sphere(2.0, -1.0, 8.0)
    carried_N = simulator.carried(contact)[0][0]
    counts = simulator.raw_frames(contact)[0]
    assert counts.shape == (68, 3) and counts.dtype == np.int32
    # y up; in steps of .1 N
    assert np.allclose(counts.sum(axis=0) * (COUNT_N, -COUNT_N, COUNT_N), carried_N, atol=0.6)


@pytest.mark.parametrize("sensor, off_N", [("paxini", 3), ("tac3d", 4)])
def test_a_head_of_another_sensor_reads_grip_and_shear(sensor, off_N):
    simulator = TactileSimulator(sensor)
    canonicalizer = Canonicalizer(sensor)
    canonicalizer.set_reference(simulator.raw_reference())
    loads = ((0.0, 0.0, 3.0), (2.0, 0.0, 6.0), (0.0, 2.0, 10.0))
    images = [canonicalizer.marker_image(simulator.raw_frames(sphere(*load))[0]) for load in loads]
    reference = canonicalizer.marker_image(simulator.raw_reference())
    latents = Tokenizer.from_pretrained().encode(reference, np.stack(images), "left")
    read_N = ForceHead.from_pretrained("gelsight")(latents).numpy()
    assert np.allclose(read_N, loads, atol=off_N)
    assert np.corrcoef(read_N.ravel(), np.ravel(loads))[0, 1] > 0.9


@pytest.mark.parametrize("words", ["paxini:3", "tac3d:3+dead=0.25+gain=1.1"])
def test_units_are_mounted_and_wipe(words):
    view = WornView(wear(words)(0))
    assert np.mean(view.images(sphere(1.0, 0.0, 6.0))[0] != view.reference) > 0.005
    sensor = words.partition(":")[0]
    env = WipeEnv("touch", right_sensor=sensor)
    assert env.reset(seed=3)[0]["pixels"][tactile_name("right")].any()
    assert env.sensors["right"] == sensor
    env.close()
