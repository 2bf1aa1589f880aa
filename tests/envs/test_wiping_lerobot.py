import numpy as np
from lerobot.envs.factory import make_env, make_env_config
from lerobot.envs.utils import env_to_policy_features, preprocess_observation

from lerobot_env_uniforce_wiping import UniforceWipingConfig
from uniforce_vtla.keys import STATE, TACTILE_KEYS, camera_key


def test_make_env_round_trip() -> None:
    config = make_env_config("uniforce_wiping", level="easy", left_sensor="uskin", episode_length=2)
    vector = make_env(config, n_envs=1)["uniforce_wiping"][0]
    observation, _ = vector.reset(seed=[3])
    frame = preprocess_observation(observation)
    wanted = env_to_policy_features(config)
    assert set(frame) == set(wanted) - {"action"}
    for key, value in frame.items():
        assert tuple(value.shape[1:]) == tuple(wanted[key].shape)
    hold = observation["agent_pos"].astype(np.float32)
    vector.step(hold)
    _, _, _, truncated, info = vector.step(hold)
    assert truncated[0] and "is_success" in (info | info.get("final_info", {}))
    assert vector.call("_max_episode_steps")[0] == 2 and vector.call("task_description")[0]
    vector.close()


def test_features_follow_the_keys() -> None:
    config = UniforceWipingConfig()
    assert {STATE, camera_key("front"), camera_key("wrist"), *TACTILE_KEYS} <= set(config.features)
    assert config.episode_length == 360 and not any("wrench" in key for key in config.features)

    exposed = env_to_policy_features(UniforceWipingConfig(expose_wrench=True))
    assert exposed["observation.wrench_left"].shape == (4,)
