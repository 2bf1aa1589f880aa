"""The recorder in its own process: the same dataset, errors that come back, a sure end."""

import os
import signal
import time
from contextlib import closing

import numpy as np
import psutil
import pytest

from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.synthetic import dots, record_synthetic
from uniforce_robots.recorder.rig import RigFacts
from uniforce_robots.recorder.rows import RECORDERS_OWN, rig_features
from uniforce_robots.recorder.store import StoreProcess, StoreSettings, open_recorder
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.keys import STATE, camera_key, tactile_key
from uniforce_vtla.terminal import STOPS

WORN = {"left": "uskin", "right": "tactip"}
CAMERAS = {"front": (48, 64, 3)}
FACTS = RigFacts("test", 30, WORN, CAMERAS, windows={"left": 3}, paced=False)
REFERENCE = dots(0)


def row(step):
    made = {camera_key("front"): np.full((48, 64, 3), 10 * step, np.uint8)}
    for finger in FINGERS:
        made[tactile_key(finger)] = dots(step)
        made[tactile_key(finger, reference=True)] = REFERENCE
    for key, feature in rig_features(FACTS).items():
        if key not in made and key not in RECORDERS_OWN:
            made[key] = np.full(feature["shape"], step + 1, feature["dtype"])
    return made


@pytest.fixture
def store(tmp_path):
    with closing(StoreProcess(FACTS, StoreSettings(tmp_path / "data", "local/test"))) as store:
        yield store


@pytest.mark.parametrize("name", ["left", "right", "tactile_left", "tactile_right_ref"])
def test_no_scene_camera_shares_a_fingers_columns(name):
    with pytest.raises(ContractError, match=f"cameras: .*, got {name}"):
        rig_features(RigFacts("test", 30, WORN, {"front": (48, 64, 3), name: (48, 64, 3)}))


def record(store, steps=4):
    memory = {key: value.copy() for key, value in row(0).items()}
    for step in range(steps):
        for key, value in row(step).items():
            memory[key][:] = value  # one array, filled over and over, as a camera's driver does
        store.add(memory, "wipe")
    store.save(True, "success", 3, card={"label": "success"})


def signal_all(store):
    for number in STOPS:
        os.kill(store.pid, number)


def test_it_stores_what_the_recorder_itself_would(store, tmp_path):
    """Also with signals while it starts and later, and rows refused at once or in the child."""
    signal_all(store)
    record(store)
    signal_all(store)
    with pytest.raises(ContractError, match="others"):
        store.add({**row(0), "something": np.zeros(1)}, "wipe")
    store.add(row(0), "wipe")
    store.add({**row(1), STATE: np.full(5, np.nan, np.float32)}, "wipe")
    with pytest.raises(ContractError, match="finite"):
        store.save(True, "success", 3)
    store.discard()
    record(store)
    with pytest.raises(DatasetError, match="2 frames"):
        store.save(True, "success", 3)
    assert store.num_episodes == 2 and store.total_frames == 8 and store.num_frames == 0
    store.close()
    with open_recorder(FACTS, StoreSettings(tmp_path / "inline", "local/test")) as inline:
        record(inline)
        record(inline)
    ours = open_dataset(tmp_path / "data")
    theirs = open_dataset(tmp_path / "inline")
    assert len(ours) == len(theirs) == 8 and store.features == inline.features
    for index in (0, 5):
        a = ours[index]
        b = theirs[index]
        assert a.keys() == b.keys()
        assert all(np.array_equal(a[k], b[k]) for k in a if k != "task")
        assert np.array_equal(a[STATE], row(index % 4)[STATE])


@pytest.mark.thorough
def test_a_killed_process_is_an_error_and_loses_the_running_episode_only(store, tmp_path):
    record(store)
    store.add(row(0), "wipe")
    os.kill(store.pid, signal.SIGKILL)
    psutil.Process(store.pid).wait(20)
    with pytest.raises(DatasetError, match="that ended"):
        record(store)
    store.close()
    assert open_dataset(tmp_path / "data").num_episodes == 1


def test_what_is_wrong_at_the_start_is_raised(tmp_path):
    settings = StoreSettings(record_synthetic(tmp_path / "other", 1, 2), "local/test")
    with (
        closing(StoreProcess(FACTS, settings)) as store,
        pytest.raises(DatasetError, match="features"),
    ):
        assert store.num_episodes
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match="empty folder"):
        StoreProcess(FACTS, StoreSettings(tmp_path, "local/test"))


def test_one_that_is_not_ready_ends_at_once(tmp_path):
    begun = time.monotonic()
    StoreProcess(FACTS, StoreSettings(tmp_path / "data", "local/test")).close()
    assert time.monotonic() - begun < 5.0, "it didn't wait for imports"
