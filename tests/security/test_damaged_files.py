"""Faults that fuzzing found, and sizes no machine holds: each was an untyped error, or memory
without end."""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.trust.damaged_checkpoints import CHECKPOINT_DAMAGES
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_datasets.pooled_quantiles import write_pooled_stats
from uniforce_datasets.source import read_source, stored_frames
from uniforce_datasets.synthetic import record_synthetic
from uniforce_vtla.array_file import read_array
from uniforce_vtla.errors import CheckpointError, ContractError, DatasetError
from uniforce_vtla.file_hashes import HASHES, check_hashes, drop_hashes
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.force_head import ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.latent_map import LatentMap
from uniforce_vtla.tokenizer.weights import load_state


@pytest.fixture
def dataset(tmp_path):
    return record_synthetic(tmp_path / "data", 1, 3)


def set_in(file, **changes):
    file.write_text(json.dumps(json.loads(file.read_text()) | changes))


def test_statistics_that_are_no_text(dataset):
    (dataset / "meta" / "stats.json").write_bytes(b'{"a": "\x99"}')
    with pytest.raises(DatasetError, match="JSON"):
        write_pooled_stats(dataset)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"[]", b"{}"])
def test_a_damaged_dataset_is_not_gone_on_with(dataset, content):
    (dataset / "meta" / "info.json").write_bytes(content)
    with pytest.raises(DatasetError, match="meta"):
        record_synthetic(dataset, 1, 3)


def test_a_video_whose_metadata_is_no_text(dataset):
    video = next((dataset / "videos").rglob("*.mp4"))
    data = video.read_bytes()
    assert b"Lavf" in data  # the encoder's name
    video.write_bytes(data.replace(b"Lavf", b"L\x83vf"))
    with pytest.raises(DatasetError, match="whole video"):
        stored_frames(video)


@pytest.mark.parametrize(
    "changes",
    [
        {"total_frames": 10**15},
        {"total_episodes": 10**15},
        {"total_frames": -1},
        {"fps": 0},
        {"fps": float("nan")},
        {"fps": "30"},
        {"features": []},
        {"codebase_version": None},
        {"features": {"observation.state": None}},
    ],
)
def test_an_info_that_cannot_be(dataset, changes):
    set_in(dataset / "meta" / "info.json", **changes)
    began_s = time.process_time()
    with pytest.raises(DatasetError):
        read_source(dataset).columns(("episode_index",))
    assert time.process_time() - began_s < 5


def test_a_processors_state_that_is_damaged(policy_copy):
    state = next(policy_copy.glob("policy_preprocessor_*.safetensors"))
    state.write_bytes(b"\xff" * 64)
    with pytest.raises(CheckpointError, match="a whole safetensors file"):
        PolicyController(policy_copy, {})


@pytest.mark.parametrize(
    "changes",
    [
        {"tiny": {"depth": 10**9}},
        {"tiny": {"width": 10**9}},
        {"image_resolution": [10**9, 56]},
        {"type": "pi05"},
        {"type": ["pi05_uniforce"]},
        {"touch": 7},
        {"touch": {"slots": 7}},
        {"swap": 5},
        {"chunk_size": "16"},
    ],
)
def test_a_policy_that_cannot_be(policy_copy, changes):
    set_in(policy_copy / "config.json", **changes)
    with pytest.raises((CheckpointError, ContractError)):
        PolicyController(policy_copy, {})


def refuses(load, folder, **changes):
    """Check that a checkpoint is read, and refused after changes to its settings, which are
    undone."""
    drop_hashes(folder)
    load()
    sound = (folder / "config.json").read_text()
    set_in(folder / "config.json", **changes)
    with pytest.raises(CheckpointError):
        load()
    (folder / "config.json").write_text(sound)


def test_tokenizers_beyond_any_machine_cost_nothing(tmp_path, tiny):
    folder = Tokenizer.random(tiny).save(tmp_path / "tokenizer")
    for changes in (
        {"width": 8192, "depth": 64},
        {"depth": 10**9},
        {"side": 2048, "patch": 1},
        {"patch": 0},
    ):
        model = tiny.facts() | changes
        refuses(lambda: Tokenizer.from_pretrained(folder), folder, model=model)


def test_heads_beyond_any_machine_cost_nothing(tmp_path):
    folder = ForceHead(ForceRegressor(HeadConfig()), "tactip", "a").save(tmp_path / "head")
    for head in ({"hidden": 4096, "grid": 64}, {"mlp": 10**12}, {"channels": "6"}):
        refuses(lambda: ForceHead.from_pretrained(path=folder), folder, head=head)


def test_calibrations_beyond_any_machine_cost_nothing(tmp_path):
    found = Calibration(LatentMap(4, 6), "a", "b", "new", "anchor", 1.0, 0.0, {})
    folder = found.save(tmp_path / "map")
    for changes in (
        {"patches": 16384},
        {"latent": 10**12},
        {"ridge": "x"},
        {"choice": {"form": "all"}},
        {"agreement": {"small": 1}},
    ):
        refuses(lambda: Calibration.load(folder, "a"), folder, **changes)


def test_an_array_that_announces_more_than_it_holds(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((3, 4)))
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data.replace(b"(3, 4), ", b"(3, 4000000000), ", 1))
    with pytest.raises(DatasetError, match="whole"):
        read_array(tmp_path / "a.npy")


def test_a_damaged_training_state_is_named(tmp_path):
    (tmp_path / "state.safetensors").write_bytes(b"\x08" + bytes(20))
    with pytest.raises(CheckpointError, match="whole training state"):
        load_state(tmp_path)


ROOT = Path(__file__).parents[2]
OURS = ("policies", "robots", "uniforce_vtla")
SHIPPED = sorted(
    path.parent for folder in OURS for path in (ROOT / folder).rglob("model.safetensors")
)
SOUND = {damage.sound: replace(damage, do=lambda _: None) for damage in CHECKPOINT_DAMAGES}


@pytest.mark.parametrize("damage", CHECKPOINT_DAMAGES, ids=lambda damage: damage.name)
def test_a_damaged_checkpoint_is_refused(damage, tmp_path):
    said = damage.refused(damage.sound, tmp_path)
    assert "expected" in said


@pytest.mark.parametrize("sound", SOUND.values(), ids=lambda damage: damage.sound.name)
def test_what_is_not_damaged_is_accepted(sound, tmp_path):
    assert sound.refused(sound.sound, tmp_path) is None


def test_every_shipped_checkpoint_is_as_it_was_saved():
    assert len(SHIPPED) >= 15
    for folder in SHIPPED:
        assert (folder / HASHES).is_file(), folder
        check_hashes(folder, CheckpointError)
