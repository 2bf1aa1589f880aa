"""The scene for any LeRobot policy: newtons behind the state, no marker images."""

from itertools import islice

import numpy as np
import pytest
from calibration_samples import save_calibration

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.aborted import make_scene
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.lerobot_config import UniforceWipingConfig
from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.keys import AXES, CAMERAS, STATE, TACTILE_KEYS
from uniforce_vtla.markers import to_finger_frame
from uniforce_vtla.tokenizer import Tokenizer


def test_the_state_ends_with_what_the_right_finger_feels():
    env = WipeEnv("touch", right_sensor="tactip", touch_in_state=True)
    errors_N = []
    for _ in islice(walk(env, WipeExpert("right"), 20_000), 100, 221, 20):
        seen = env.observe()
        assert set(seen["pixels"]) == set(CAMERAS)
        assert env.observation_space.contains(seen)
        true_N = to_finger_frame(env.true_wrench()["right"][:3].astype(np.float32), "right")
        errors_N.append(seen["agent_pos"][len(AXES) :] - true_N)
    assert np.abs(np.median(errors_N, axis=0)).max() < 1.5


def test_lerobots_settings_say_so():
    config = UniforceWipingConfig(touch_in_state=True)
    assert config.features[STATE].shape == (len(AXES) + 3,)
    assert not set(config.features) & set(TACTILE_KEYS)
    scene = make_scene(**config.gym_kwargs)
    observation, _ = scene.reset(seed=20_000)
    assert scene.observation_space.contains(observation)
    assert UniforceWipingConfig().features.keys() >= set(TACTILE_KEYS)


def test_a_calibration_that_nothing_is_read_with_is_refused(tmp_path):
    with pytest.raises(ContractError, match="touch_in_state"):
        WipeEnv(right_calibration=str(tmp_path))
    with pytest.raises(CheckpointError):
        WipeEnv(right_calibration=str(tmp_path), touch_in_state=True)


def test_a_calibration_of_another_kind_is_refused(tmp_path):
    folder = save_calibration(tmp_path, Tokenizer.from_pretrained(), new="uskin:2")
    with pytest.raises(CheckpointError, match="one of a tactip"):
        WipeEnv(right_sensor="tactip", right_calibration=folder, touch_in_state=True)
