"""Ordinary LeRobot datasets with touch as numbers: newtons in the state, or latents in columns."""

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType
from lerobot.datasets import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_policy_pi05_uniforce import PI05UniforceConfig, PI05UniforcePolicy
from uniforce_cli import view
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.source import marker_images
from uniforce_datasets.synthetic import record_synthetic
from uniforce_datasets.training_view import TrainingView, build_view
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.force_sensor import ForceSensor
from uniforce_vtla.keys import (
    ACTION,
    AXES,
    CAMERAS,
    STATE,
    TACTILE_KEYS,
    camera_key,
    latent_key,
)
from uniforce_vtla.tokenizer import Tokenizer

FRAMES = 10


@pytest.fixture(scope="module")
def demos(tmp_path_factory):
    return record_synthetic(tmp_path_factory.mktemp("force") / "demos", episodes=2, frames=FRAMES)


@pytest.fixture(scope="module")
def written(demos):
    out = demos.parent / "forces"
    call = [f"roots={demos}", f"out={out}", "touch_in_state=true", "tokenizer=nano"]
    assert view.main(call) == 0
    return out


def test_the_state_holds_what_the_force_sensor_reads(demos, written):
    dataset = LeRobotDataset("local/forces", root=written)
    feature = dataset.meta.features[STATE]
    assert list(feature["names"]) == [*AXES, "right_fx", "right_fy", "right_fz"]
    sensor = ForceSensor("", "right", tokenizer="nano")
    assert feature["info"] == sensor.facts()
    source = check_dataset(demos)
    episode = source.episodes[1]
    reference, images = marker_images(episode, source.fps, "right")
    stored = source.columns((STATE, ACTION))
    for frame, image in enumerate(images, FRAMES):
        row = dataset[frame]
        felt = sensor.read_markers(reference, image)
        np.testing.assert_allclose(row[STATE][len(AXES) :], felt.force_N, atol=1e-4)
        np.testing.assert_array_equal(row[STATE][: len(AXES)], stored[STATE][frame])
        np.testing.assert_array_equal(row[ACTION], stored[ACTION][frame])
        assert row["task"] == "wipe the dots"


def test_quantiles_are_those_of_all_frames(written):
    dataset = LeRobotDataset("local/forces", root=written)
    states = np.stack([dataset[frame][STATE] for frame in range(dataset.num_frames)])
    q99 = dataset.meta.stats[STATE]["q99"]
    np.testing.assert_allclose(q99, np.quantile(states.astype(np.float64), 0.99, axis=0), rtol=1e-6)


def test_an_interrupted_dataset_is_none(demos, tmp_path, monkeypatch):
    calls = []

    def stopped(self):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(LeRobotDataset, "save_episode", stopped)
    call = [f"roots={demos}", f"out={tmp_path / 'forces'}", "touch_in_state=true", "tokenizer=nano"]
    assert view.main(call) == 130
    assert not (tmp_path / "forces").exists()


def test_marker_images_are_left_out(written):
    dataset = LeRobotDataset("local/forces", root=written)
    assert set(dataset.meta.camera_keys) == {camera_key(camera) for camera in CAMERAS}
    assert not set(dataset.meta.features) & set(TACTILE_KEYS)


def test_stock_act_takes_it(written):
    dataset = LeRobotDataset("local/forces", root=written, delta_timestamps={ACTION: [0.0, 1 / 30]})
    features = dataset_to_policy_features(dataset.meta.features)
    actions = {key: one for key, one in features.items() if one.type is FeatureType.ACTION}
    config = ACTConfig(
        input_features={key: one for key, one in features.items() if key not in actions},
        output_features=actions,
        chunk_size=2,
        n_action_steps=2,
        dim_model=32,
        n_heads=2,
        dim_feedforward=32,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    loss, _ = ACTPolicy(config).forward(torch.utils.data.default_collate([dataset[0], dataset[5]]))
    assert bool(loss.isfinite())


def test_nothing_is_overwritten_and_an_empty_choice_is_refused(demos, written, refuses):
    again = [f"roots={demos}", "touch_in_state=true"]
    for ignored in ("workers=4", "latent_grid=2", "slots=touch0:left"):
        refuses(view.main, [*again, f"out={written}2", ignored], f"got {ignored.split('=')[0]}")
    refuses(view.main, [*again, f"out={written}"], "Choose another out")
    refuses(
        view.main, [*again, f"out={written}2", "cameras=front:cam_high"], "cameras keep their names"
    )


def make_policy(root, **touch):
    meta = LeRobotDataset("local/felt", root=root).meta
    features = dataset_to_policy_features(meta.features)
    config = PI05UniforceConfig(
        size="tiny",
        device="cpu",
        input_features={key: one for key, one in features.items() if key != ACTION},
        output_features={ACTION: features[ACTION]},
    )
    config.touch.slots = {"touch0": "right"}
    for name, value in touch.items():
        setattr(config.touch, name, value)
    return PI05UniforcePolicy(config, dataset_meta=meta)


def test_a_policy_that_feels_by_itself_refuses_it(written):
    with pytest.raises(DatasetError, match="feels by itself"):
        make_policy(written)


@pytest.fixture(scope="module")
def latents(demos):
    out = demos.parent / "latents"
    call = [f"roots={demos}", f"out={out}", "form=dataset", "tokenizer=nano", "slots=touch0:right"]
    assert view.main(call) == 0
    return out


def test_latent_columns_are_those_of_the_training_view(demos, latents):
    dataset = LeRobotDataset("local/latents", root=latents)
    key = latent_key("touch0")
    feature = dataset.meta.features[key]
    assert feature["shape"] == (96,) and not set(dataset.meta.features) & set(TACTILE_KEYS)
    tokenizer = Tokenizer.from_pretrained("nano").hash
    assert feature["info"] == {"tokenizer": tokenizer, "finger": "right", "sensors": "tactip"}
    arrays = TrainingView(build_view([demos], demos.parent / "arrays", tokenizer="nano"))
    for frame in (0, FRAMES + 3):
        np.testing.assert_allclose(dataset[frame][key], arrays[frame][key], atol=1e-5)


def test_a_policy_takes_the_latents_of_its_own_tokenizer_and_finger_alone(latents):
    policy = make_policy(latents, tokenizer_path="nano")
    assert policy.config.touch.trained_sensors == {"touch0": "tactip"}
    with pytest.raises(DatasetError, match="latents of touch0"):
        make_policy(latents)  # the shipped tokenizer is another
    with pytest.raises(DatasetError, match="finger left"):
        make_policy(latents, tokenizer_path="nano", slots={"touch0": "left"})
