"""A sensor is one file and its place in the registry: docs/own_sensor.md's example does all that a
known one does."""

from pathlib import Path

import numpy as np
import pytest
from contact_samples import sphere
from standins import mygel

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_datasets.features import sensor_index
from uniforce_vtla import Canonicalizer, ForceHead, Tokenizer
from uniforce_vtla.contact import ContactOptions, TactileSimulator
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.markers.identity import why_not
from uniforce_vtla.markers.registration import drawn_px
from uniforce_vtla.sensors import get_sensor, list_sensors, registry

FILE = Path(mygel.__file__)
PAGE = Path(__file__).parents[1] / "docs" / "own_sensor.md"
MOST_LINES = 60
FORCE_N = (1.5, -1.0, 6.0)


@pytest.fixture
def known(monkeypatch):
    """Do what the page asks for: add the sensor behind the others."""
    monkeypatch.setitem(registry._SENSORS, "mygel", mygel.MYGEL)


def test_the_page_shows_the_file_and_it_is_short():
    text = FILE.read_text()
    assert text in PAGE.read_text() and len(text.splitlines()) <= MOST_LINES


def test_datasets_store_it_behind_the_others(known):
    sensors = list_sensors()
    assert sensors[-1] == "mygel"
    assert list(map(sensor_index, sensors)) == list(range(len(sensors)))


def test_its_frames_come_back_as_its_drawing_and_force_is_read(known):
    simulator, canonicalizer = TactileSimulator("mygel"), Canonicalizer("mygel")
    free, touched = simulator.raw_reference(), simulator.raw_frames(sphere(*FORCE_N))[0]
    spec, centres_px = get_sensor("mygel"), Canonicalizer("mygel").markers(free)
    assert why_not(spec, centres_px, "it") is None
    places = drawn_px(spec)
    apart = np.linalg.norm(centres_px[:, None] - places, axis=2)
    assert len(centres_px) == len(places) and apart.min(axis=1).max() < 2.0  # px
    pair = canonicalizer.pair(free, touched, finger="left")
    assert canonicalizer.match is not None and np.mean(pair.reference != pair.current) > 0.01
    latent = Tokenizer.from_pretrained().encode(pair)
    read_N = ForceHead.from_pretrained("tactip")(latent)[0].numpy()
    assert (np.sign(read_N) == np.sign(FORCE_N)).all() and 2 < read_N[2] < 12


def test_the_contact_model_moves_its_markers_with_the_force(known):
    simulator = TactileSimulator("mygel", options=ContactOptions().quiet())
    (moved_px, _), (rest_px, _) = (simulator.markers_px(sphere(fx, 0, 6)) for fx in (2.0, 0.0))
    x, y = (moved_px - rest_px)[0].mean(axis=0)
    assert x > 0.5 and abs(y) < 0.1


def test_a_scene_wears_units_of_it(known):
    env = WipeEnv("touch", right_sensor="mygel:any")
    shown = env.reset(seed=3)[0]["pixels"][tactile_name("right")]
    assert env.sensors["right"] == "mygel" and shown.any()
    env.step(env.observe()["agent_pos"])
    env.close()
