import itertools
import json
import os
import pickle
import shutil
import time
from concurrent.futures import BrokenExecutor
from functools import partial
from types import SimpleNamespace
from unittest.mock import DEFAULT, Mock

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, RandomSampler

from benchmarks.trust.injuries import edit_json, flip_bit
from uniforce_datasets import view_build
from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.synthetic import (
    FPS,
    BlockMeans,
    dots,
    record_synthetic,
    synthetic_frame,
)
from uniforce_datasets.training_view import TrainingView, build_view, make_training_dataset
from uniforce_datasets.view_build import PROGRESS, resize
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.keys import (
    ACTION,
    CAMERAS,
    STATE,
    VIEW_MARKER,
    camera_key,
    latent_key,
    truth_wrench_key,
    wrench_key,
)
from uniforce_vtla.results_file import only_writer

EPISODES, FRAMES = 3, 20
DELTAS = [-1, 0, 1, 2, 3]


built = partial(build_view, encoder=BlockMeans())


def camera_of(sample, name="front"):
    """Return (H, W, 3) of a sample's camera."""
    return sample[camera_key(name)].permute(1, 2, 0).numpy()


def test_samples_equal_stock_lerobot(demos, view):
    stock = open_dataset(
        demos, delta_timestamps={ACTION: [d / FPS for d in DELTAS]}, return_uint8=True
    )
    fast = TrainingView(view, DELTAS, {"touch0": "right", "touch1": "left"})
    assert len(fast) == len(stock) == EPISODES * FRAMES
    numbers = ("timestamp", "frame_index", "episode_index", "index", "task_index")
    for index in (0, 1, FRAMES - 2, FRAMES - 1, FRAMES, 2 * FRAMES + 7, EPISODES * FRAMES - 1):
        wanted, came = stock[index], fast[index]
        for key in (STATE, ACTION, f"{ACTION}_is_pad", *numbers):
            assert torch.equal(wanted[key], came[key]), (index, key)
            assert wanted[key].dtype == came[key].dtype
        assert wanted["task"] == came["task"]
        for camera in CAMERAS:
            small = camera_of(came, camera)
            assert small.shape == (56, 56, 3) and small.dtype == np.uint8
            assert np.array_equal(small, resize(camera_of(wanted, camera), 56))


def test_latents_are_those_of_each_slots_finger(view):
    wanted = BlockMeans()(dots(0), dots(20 * np.sin(7 / 5))[None], "left")[0]
    assert wanted.any()
    only_left = TrainingView(view, slots={"touch0": "left"})
    for made in (TrainingView(view), only_left):
        np.testing.assert_array_equal(made[FRAMES + 7][latent_key("touch0")], wanted)
    assert latent_key("touch1") not in {*only_left[0], *only_left.features}


def test_fingers_are_not_confused(demos, tmp_path):
    def sign(reference, current, finger):
        return np.full((len(current), 96), {"left": 1, "right": -1}[finger])

    sign.hash = "sign"
    sample = TrainingView(built(demos, tmp_path / "view", encoder=sign))[0]
    assert sample[latent_key("touch0")].unique() == -1
    assert sample[latent_key("touch1")].unique() == 1


def test_wrench_input_is_the_recorded_truth(demos, view):
    stock, fast = open_dataset(demos), TrainingView(view, slots={"touch0": "right"}, touch="wrench")
    assert torch.equal(stock[33][truth_wrench_key("right")], fast[33][wrench_key("touch0")])
    assert latent_key("touch0") not in fast[33]
    plain = {*map(camera_key, CAMERAS), STATE, ACTION}
    assert set(TrainingView(view, touch="none").features) == plain


def test_metadata_serves_sampler_and_policy(demos, view):
    from lerobot.datasets.sampler import EpisodeAwareSampler
    from lerobot.utils.feature_utils import dataset_to_policy_features

    made = TrainingView(view, episodes=[0, 2])
    assert made.num_episodes == 2 and made.num_frames == 2 * FRAMES
    assert (made.meta.used_episodes, made.meta.used_frames) == (2, 2 * FRAMES)
    bounds = made.meta.episodes["dataset_from_index"], made.meta.episodes["dataset_to_index"]
    sampler = EpisodeAwareSampler(*bounds, episode_indices_to_use=made.episodes, shuffle=True)
    assert {int(made[i]["episode_index"]) for i in sampler} == {0, 2}
    policy = dataset_to_policy_features(made.meta.features)
    assert policy[camera_key("front")].shape == (3, 56, 56)
    assert policy[latent_key("touch0")].shape == (96,)
    whole = TrainingView(view).meta.stats
    stored = json.loads((demos / "meta" / "stats.json").read_text())
    for name in ("q01", "q99", "mean", "std"):
        np.testing.assert_allclose(whole[STATE][name], stored[STATE][name], rtol=1e-9)


def test_view_travels_to_loader_workers(view):
    made = TrainingView(view, DELTAS)
    packed = pickle.dumps(made)
    assert len(packed) < 50_000
    again = pickle.loads(packed)
    assert torch.equal(again[5][camera_key("front")], made[5][camera_key("front")])


def test_interrupted_build_goes_on(demos, tmp_path, view):
    def fragile(calls):
        """Return an encoder that breaks after so many calls."""
        latents = [*itertools.repeat(DEFAULT, calls), KeyboardInterrupt]
        return Mock(wraps=BlockMeans(), hash=BlockMeans.hash, side_effect=latents)

    out = tmp_path / "view"
    with pytest.raises(KeyboardInterrupt):
        built(demos, out, encoder=fragile(3))
    assert not out.exists()
    assert json.loads((tmp_path / "view.building" / PROGRESS).read_text())["done"] == 1
    built(demos, out, encoder=fragile(4))  # two episodes of two fingers remain
    for name in ("front", "latent_left", "latent_right", STATE):
        assert np.array_equal(np.load(out / f"{name}.npy"), np.load(view / f"{name}.npy"))
    built(demos, out, encoder=fragile(0))  # nothing to do


def test_a_killed_worker_ends_the_build(monkeypatch):
    monkeypatch.setattr(view_build, "_episode_blocks", os._exit)
    with pytest.raises(BrokenExecutor):
        list(view_build._in_turn([9, 9], workers=2))


def test_one_process_builds_a_view_at_a_time(demos, tmp_path):
    with (
        only_writer(tmp_path / "view.building"),
        pytest.raises(ContractError, match="another one too"),
    ):
        built(demos, tmp_path / "view")
    assert TrainingView(built(demos, tmp_path / "view"))


def record(root, frame, *episodes, **more):
    """Record a frame over and over, under the instructions of each episode."""
    with EpisodeRecorder(root, "local/x", "gelsight", "tactip", FPS, **more) as recorder:
        for words in episodes:
            for task in words:
                recorder.add(frame, task)
            recorder.save(success=True, outcome="success", seed=0)
    return root


def test_cameras_of_other_names_are_renamed_in_a_view(tmp_path):
    root = tmp_path / "demos"
    pictures = {"front": 40, "wrist": 200}
    recorded = {"front": "cam_high", "wrist": "cam_wrist"}
    shapes = dict.fromkeys(recorded.values(), (64, 64, 3))
    frame = synthetic_frame(0, np.random.default_rng(0))
    for camera, name in recorded.items():
        del frame[camera_key(camera)]
        frame[camera_key(name)] = np.full((64, 64, 3), pictures[camera], np.uint8)
    record(root, frame, ["wipe"] * 3, cameras=shapes)
    refused = r"without .*images\.front.* Rename its cameras \(cam_high, cam_wrist\) with cameras="
    with pytest.raises(DatasetError, match=refused):
        built(root, tmp_path / "none")
    with pytest.raises(ContractError, match=r"camera: expected front \| wrist"):
        built(root, tmp_path / "none", cameras={"cam_high": "front"})
    view = built(root, tmp_path / "view", cameras=recorded)
    for camera, grey in pictures.items():
        assert abs(camera_of(TrainingView(view)[2], camera).mean() - grey) < 3
    swapped = {"front": "cam_wrist", "wrist": "cam_high"}
    built(root, tmp_path / "view", cameras=swapped)  # built anew
    assert camera_of(TrainingView(view)[2]).mean() > 190


def test_each_frame_keeps_its_own_instruction(tmp_path):
    said = ["grasp the eraser"] * 3 + ["wipe the board"] * 4
    frame = synthetic_frame(0, np.random.default_rng(0))
    root = record(tmp_path / "demos", frame, said, said[:3], said[::-1])
    made = TrainingView(built(root, tmp_path / "view"))
    assert [made[i]["task"] for i in range(len(made))] == [*said, *said[:3], *said[::-1]]
    both = sorted(set(said))
    assert made.meta.episodes["tasks"] == [both, said[:1], both]
    assert [e["task"] for e in made.marker["episodes"]] == [said[0], said[0], said[-1]]
    np.save(tmp_path / "view" / "task_index.npy", np.full(len(made), 2))
    with pytest.raises(DatasetError, match="task_index"):
        TrainingView(tmp_path / "view", verify="off")


def test_sensors_are_those_of_the_episodes_sampled_from(view, tmp_path):
    mixed = shutil.copytree(view, tmp_path / "mixed")
    edit_json(mixed / VIEW_MARKER, lambda view: view["episodes"][1].update(left_sensor="uskin"))
    for episodes, sensors in (
        (None, ["gelsight", "uskin"]),
        ([0, 2], ["gelsight"]),
        ([1], ["uskin"]),
    ):
        made = TrainingView(mixed, episodes=episodes, verify="off")
        assert made.meta.sensors["left"] == sensors


def test_refusals(demos, view, tmp_path):
    with pytest.raises(DatasetError, match="chosen episode"):
        built(demos, tmp_path / "none", keep=lambda facts: False)
    with pytest.raises(ContractError, match="slot"):
        built(demos, tmp_path / "none", slots={"touch9": "left"})
    with pytest.raises(DatasetError, match="other files"):
        built(demos, demos)
    with pytest.raises(DatasetError, match=r"uniforce_view\.json"):
        TrainingView(tmp_path)
    with pytest.raises(ContractError, match="touch"):
        TrainingView(view, touch="smell")


def trainer_config(root, **policy):
    defaults = {"action_delta_indices": DELTAS, "observation_delta_indices": None}
    transforms = SimpleNamespace(enable=False)
    dataset = SimpleNamespace(
        root=root, repo_id="local/x", episodes=None, image_transforms=transforms
    )
    return SimpleNamespace(dataset=dataset, trainable_config=SimpleNamespace(**(defaults | policy)))


def test_trainer_gets_what_its_policy_asks_for(demos, view):
    fingers = {"slots": ("touch0",), "finger_by_slot": lambda: {"touch0": "left"}}
    touch = {"touch_in_view": "latent", "latent_grid": 4, **fingers}
    made = make_training_dataset(trainer_config(view, **touch), pytest.fail)
    assert made[0][ACTION].shape == (5, 5) and latent_key("touch0") in made.features
    blind = make_training_dataset(trainer_config(view), pytest.fail)
    assert latent_key("touch0") not in blind.features
    with pytest.raises(DatasetError, match="latent_grid=2"):
        make_training_dataset(trainer_config(view, **(touch | {"latent_grid": 2})), pytest.fail)
    assert make_training_dataset(trainer_config(demos), lambda cfg: "stock") == "stock"


def test_a_dataset_from_the_hub_is_checked_in_full_where_it_was_downloaded(demos, tmp_path):
    blobs, snapshot = tmp_path / "cache" / "blobs", tmp_path / "cache" / "snapshots" / "0"
    shutil.copytree(demos, blobs, ignore=shutil.ignore_patterns(".*"))
    shutil.copytree(blobs, snapshot, copy_function=os.symlink)  # as the hub's cache keeps files
    cfg = trainer_config(None)
    cfg.dataset.repo_id, cfg.dataset.streaming = "somebody/wipe", False
    downloaded = SimpleNamespace(root=snapshot)
    assert make_training_dataset(cfg, lambda cfg: downloaded) is downloaded
    flip_bit(next((blobs / "videos" / camera_key("front")).rglob("*001.mp4")))
    with pytest.raises(DatasetError, match=r"front.*episode 1"):
        make_training_dataset(cfg, lambda cfg: downloaded)
    assert make_training_dataset(cfg, lambda cfg: downloaded, "quick") is downloaded


def test_a_damaged_view_is_built_anew(demos, tmp_path):
    out = built(demos, tmp_path / "view")
    kept = (out / "latent_left.npy").read_bytes()
    flip_bit(out / "latent_left.npy")
    with pytest.raises(DatasetError, match=r"latent_left.*uniforce view"):
        TrainingView(out)
    built(demos, out)
    assert (out / "latent_left.npy").read_bytes() == kept
    assert len(TrainingView(out)) == EPISODES * FRAMES


@pytest.mark.thorough
def test_view_feeds_the_trainer_fast_enough(tmp_path):
    """The whole chunk of the tiny policy, 16 actions, and episodes of 3 s, so that random access is
    real."""
    data = record_synthetic(tmp_path / "data", episodes=3, frames=90)
    chunk = {"action": [step / FPS for step in range(16)]}
    stock = samples_per_s(open_dataset(data, delta_timestamps=chunk, return_uint8=True))
    view = built(data, tmp_path / "view", keep=lambda facts: True)
    fast = samples_per_s(TrainingView(view, range(16)))
    assert fast >= 200 and fast > 3 * stock, (fast, stock)


def samples_per_s(dataset):
    """Return what one process gives through a shuffling DataLoader in batches of 8, its first batch
    left out."""
    sampler = RandomSampler(dataset, replacement=True, num_samples=10**6)
    batches = iter(DataLoader(dataset, batch_size=8, sampler=sampler))
    next(batches)
    start = time.perf_counter()
    calls = 0
    while (spent_s := time.perf_counter() - start) < 1.0:
        next(batches)
        calls += 1
    return 8 * calls / spent_s


@pytest.mark.thorough
def test_two_datasets_make_one_view_however_many_processes_build_it(demos, tmp_path):
    one, two = (
        built([demos, demos], tmp_path / str(n), keep=lambda facts: facts.episode != 1, workers=n)
        for n in (1, 2)
    )
    contents = [{path.name: path.read_bytes() for path in made.iterdir()} for made in (one, two)]
    assert contents[0] == contents[1]
    both = TrainingView(one)
    assert both.num_episodes == 4 and len(both) == 4 * FRAMES
    assert torch.equal(both[0][STATE], both[2 * FRAMES][STATE])
    assert both.meta.sensors == {"left": ["gelsight"], "right": ["tactip"]}
