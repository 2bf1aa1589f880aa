"""A sensor that fails under LeRobot's evaluation ends its episode, and no run."""

import numpy as np
import pytest
import torch
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.policies.factory import make_pre_post_processors
from lerobot.scripts.lerobot_eval import rollout

from lerobot_env_uniforce_wiping import UniforceWipingConfig
from lerobot_env_uniforce_wiping.aborted import make_scene
from lerobot_env_uniforce_wiping.touch import PadImages
from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config
from uniforce_vtla.errors import SensorError

DARK = "tactip:1+light=0"  # its reference is refused
LOST = "no picture"
HELD = np.array([0.5, 0.0, 0.08, 0.0, 0.05], np.float32)


@pytest.mark.parametrize("steps", [0, 3])
def test_an_episode_is_truncated_where_its_sensor_fails_and_the_next_one_goes_on(
    steps, monkeypatch
):
    env = make_scene(right_sensor="tactip:1" if steps else DARK)
    observation, info = env.reset(seed=11)
    assert env.observation_space.contains(observation) and ("aborted" in info) == (not steps)
    for _ in range(steps):
        assert not env.step(HELD)[3]
    with monkeypatch.context() as patch:
        if steps:
            patch.setattr(PadImages, "image", _refuse)
        seen, reward, terminated, truncated, info = env.step(HELD)
    again = env.step(HELD)
    assert again[3] and again[4]["aborted"] == info["aborted"], "an aborted episode stays so"
    assert truncated and not terminated and not info["is_success"] and reward == 0.0
    assert info["aborted"].startswith(LOST if steps else "tactip on the right finger: ")
    assert env.observation_space.contains(seen)
    if steps:
        env.reset(seed=11)
        assert not env.step(HELD)[3]


def _refuse(*_):
    raise SensorError(LOST)


def test_lerobots_evaluation_survives_a_sensor_that_fails_at_the_first_look():
    settings = UniforceWipingConfig(level="touch", right_sensor=DARK, episode_length=3)
    scenes = make_env(settings, n_envs=2)["uniforce_wiping"][0]
    config = stored_config(shipped_checkpoint())
    policy = PI05UniforcePolicy.from_pretrained(shipped_checkpoint(), config=config)
    pipelines = make_pre_post_processors(config, pretrained_path=str(shipped_checkpoint()))
    around = make_env_pre_post_processors(env_cfg=settings, policy_cfg=config)
    with torch.inference_mode():
        found = rollout(scenes, policy, *around, *pipelines, seeds=[5, 6])
    assert found["done"][:, 0].all() and not found["success"].any()
    scenes.close()
