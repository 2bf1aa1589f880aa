import os
import subprocess
import sys
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from lerobot.envs.factory import make_env, make_env_config
from lerobot.envs.utils import env_to_policy_features, preprocess_observation

from lerobot_env_uniforce_wiping import (
    ExpertNoise,
    UniforceWipingConfig,
    WipeEnv,
    WipeExpert,
    draw_scene,
)
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.sequence import Sweep
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.contact.worn import drawing
from uniforce_vtla.contracts import FINGERS, check_marker_image
from uniforce_vtla.errors import ContractError, RolloutError, SensorError
from uniforce_vtla.evaluation.episode import EpisodeTrace
from uniforce_vtla.keys import tactile_name

SEED = 4


@pytest.fixture(scope="module")
def grasped():
    """A scene whose expert has wiped for eight steps."""
    env = WipeEnv()
    expert = WipeExpert()
    wiped = 0
    for _ in walk(env, expert, SEED):
        wiped += expert.phase == "wipe"
        if wiped == 8:
            return env


def test_observation_of_a_grasp_is_inside_its_space(grasped):
    assert grasped.observation_space.contains(grasped.observe())


def test_gymnasium_finds_no_fault_and_no_two_observations_share_memory():
    stalled = replace(drawing(as_virtual("tactip")), stall_steps=2)
    env = WipeEnv(left_sensor=stalled, right_sensor="tactip:drawing", expose_wrench=True)
    check_env(env)
    given = [env.reset(seed=SEED)[0], env.step(env.state)[0], env.step(env.state)[0], env.observe()]
    arrays = [*env.marker_pair("left"), *env.marker_pair("left")]
    for seen in given:
        arrays += [*seen["pixels"].values(), seen["agent_pos"], seen["wrench_left"]]
    reference = given[0]["pixels"]["tactile_left_ref"].copy()
    for n, array in enumerate(arrays):
        array[:] = n  # a wrapper that works in place
    assert all((array == n).all() for n, array in enumerate(arrays))
    assert np.array_equal(env.observe()["pixels"]["tactile_left_ref"], reference)


def test_marker_images_hold_only_black_and_white_on_three_equal_channels(grasped):
    pixels = grasped.observe()["pixels"]
    for finger in FINGERS:
        for reference in (False, True):
            image = pixels[tactile_name(finger, reference)]
            check_marker_image(np.ascontiguousarray(image[..., 0]))
            assert (image == image[..., :1]).all()
        moved = pixels[tactile_name(finger)] != pixels[tactile_name(finger, reference=True)]
        assert moved.mean() > 0.002, "a gripped pad must look different from its reference"


def test_same_seed_same_episode_and_other_seed_another():
    first, again, other = (WipeEnv().reset(seed=seed)[0] for seed in (7, 7, 8))
    np.testing.assert_equal(first, again)
    assert not np.array_equal(first["agent_pos"], other["agent_pos"])
    assert not np.array_equal(first["pixels"]["front"], other["pixels"]["front"])


def test_pictures_show_ink_that_goes_away():
    def inked(picture):
        r, _, b = picture.astype(int).transpose(2, 0, 1)
        return int(((b - r > 60) & (r < 60) & (b < 140)).sum())

    env = WipeEnv()
    before = inked(env.reset(seed=SEED)[0]["pixels"]["front"])
    env.sim.ink.ink[:] = 0
    env.sim.ink.version += 1
    assert before > inked(env.render()) + 30


@pytest.mark.parametrize(
    "action, error",
    [
        (np.array([0.5, 0.0, np.nan, 0.0, 0.05]), RolloutError),
        (np.zeros(4), ContractError),
        (np.zeros((1, 5)), ContractError),
        ("down", ContractError),
    ],
)
def test_bad_action_is_refused_and_the_target_held(grasped, action, error):
    target = grasped.sim.target.copy()
    control = grasped.sim.data.ctrl.copy()
    with pytest.raises(error):
        grasped.advance(action)
    assert np.array_equal(grasped.sim.target, target)
    assert np.array_equal(grasped.sim.data.ctrl, control)


def test_bad_settings_are_refused():
    with pytest.raises(SensorError):
        WipeEnv(left_sensor="thumb")
    with pytest.raises(ContractError, match="easy"):
        WipeEnv(level="impossible")
    with pytest.raises(RolloutError, match="reset"):
        WipeEnv().advance(np.zeros(5))
    with pytest.raises(ContractError, match="both"):
        WipeExpert("thumb")


def test_step_reports_success_and_metrics_every_time():
    env = WipeEnv(max_steps=3)
    observation, info = env.reset(seed=SEED)
    assert not info["is_success"]
    hold = observation["agent_pos"]
    for step in range(3):
        _, reward, terminated, truncated, info = env.step(hold)
        assert reward == 0 and not terminated and truncated is (step == 2)
        assert info["is_success"] is False and np.isfinite(list(info["metrics"].values())).all()
    assert isinstance(env.trace, EpisodeTrace) and len(env.trace.time_s) == 3
    assert env.result().outcome == "failed_grasp"


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_expert_wipes_clean_with_smooth_and_slow_targets(seed):
    env = WipeEnv(drawn=())
    speed = np.abs(np.diff(list(walk(env, WipeExpert(), seed)), axis=0)) * 30
    assert env.result().clean, env.result().reasons
    assert speed[:, 2].max() <= 0.080 and np.hypot(speed[:, 0], speed[:, 1]).max() <= 0.120


@pytest.mark.thorough
def test_runs_without_gl_and_loads_mujoco_with_the_first_scene_only():
    code = "import sys, lerobot_env_uniforce_wiping as w; assert 'mujoco' not in sys.modules; "
    code += "print(w.WipeEnv().reset(seed=1)[0]['pixels']['front'].std())"
    env = os.environ | {"MUJOCO_GL": "disable"}
    run = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=240
    )
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) > 10


def descent(seed, noise, level="touch"):
    """Return measured and commanded height (n, 2), m, of an expert going down to the eraser."""
    env = WipeEnv(level, drawn=())
    expert = WipeExpert(noise=noise)
    env.start(seed)
    expert.reset(env)
    heights = []
    while (command := expert.act(env)) is not None and expert.phase == "descend":
        heights.append((float(env.state[2]), float(command[2])))
        env.advance(command)
    return np.array(heights)


def test_a_soft_arm_is_not_far_behind_its_command_where_the_hand_must_stop():
    """A policy sees neither command nor stiffness: where they differ by more, it grasps too low."""
    leads_m = {}
    for seed in (41_018, 41_026):
        path = descent(seed, ExpertNoise(grasp_sd_m=0.0, carry_sd_m=0.0), "easy")
        first = np.argmax(path[:, 0] < 0.040)  # 10 mm above the grasp
        leads_m[draw_scene(seed, "easy").stiffness_scale] = path[first, 0] - path[first, 1]
    soft, stiff = sorted(leads_m)
    assert soft < 0.6 and stiff > 1.4
    assert leads_m[soft] - leads_m[stiff] < 0.010


def test_every_expert_grasps_at_a_height_of_its_own():
    varied = [descent(seed, ExpertNoise())[-1, 0] for seed in range(6)]
    alike = [descent(seed, ExpertNoise(grasp_sd_m=0.0))[-1, 0] for seed in range(6)]
    assert np.std(varied) > 0.002 > np.std(alike)


def test_a_hand_that_arrives_beside_its_row_comes_to_it(monkeypatch):
    """A policy arrives there, too; without demos of the way back it takes a wrong row."""
    beside_m = np.array([0.008, -0.016])
    monkeypatch.setattr(WipeExpert, "_stray", lambda self: beside_m)
    env = WipeEnv("touch", drawn=())
    expert = WipeExpert()
    env.start(SEED)
    path = [env.state[:2]]
    by_phase = {}
    for command in walk(env, expert, SEED):
        path.append(command[:2])
        by_phase.setdefault(expert.phase, command[:2])  # at the beginning of each phase
    start = Sweep(env.level).point(0.0)
    assert np.linalg.norm(by_phase["lower"] - start - beside_m) < 0.005
    assert np.linalg.norm(by_phase["wipe"] - start) < 0.5 * np.linalg.norm(beside_m)
    fastest_m_s = 30 * np.linalg.norm(np.diff(path, axis=0), axis=1).max()
    assert fastest_m_s < 0.140 and env.result().success


def test_make_env_round_trip():
    config = make_env_config("uniforce_wiping", level="easy", left_sensor="uskin", episode_length=2)
    vector = make_env(config, n_envs=1)["uniforce_wiping"][0]
    observation, _ = vector.reset(seed=[3])
    frame = preprocess_observation(observation)
    wanted = env_to_policy_features(config)
    shapes = {key: tuple(value.shape[1:]) for key, value in frame.items()}
    assert shapes == {key: one.shape for key, one in wanted.items() if key != "action"}
    hold = observation["agent_pos"].astype(np.float32)
    vector.step(hold)
    _, _, _, truncated, info = vector.step(hold)
    assert truncated[0] and "is_success" in (info | info.get("final_info", {}))
    assert vector.call("_max_episode_steps")[0] == 2 and vector.call("task_description")[0]
    vector.close()


def test_features_follow_the_keys():
    config = UniforceWipingConfig()
    assert config.episode_length == 360 and not any("wrench" in key for key in config.features)
    exposed = env_to_policy_features(UniforceWipingConfig(expose_wrench=True))
    assert exposed["observation.wrench_left"].shape == (4,)


def test_a_late_expert_answers_to_what_it_felt_before():
    """Recorded experts feel as late as pictures are: what they answer to can then be seen."""
    exact = ExpertNoise(force_sd_N=0.0, force_gain_sd=0.0)
    env = WipeEnv("easy", drawn=())
    expert = WipeExpert(noise=exact, late_steps=2)
    grips = []  # after each step: the next answer may know of it
    answered = []
    for _ in islice(walk(env, expert, SEED), 100):
        grips.append(np.mean([env.true_wrench()[finger][2] for finger in FINGERS]))
        answered.append(expert._contact.grip_N)
    assert max(grips) > 3
    np.testing.assert_allclose(answered[3:], grips[:-3], atol=1e-5)
