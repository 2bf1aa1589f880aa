"""The scene's hand: the robot's rules, bounded force, slow readings, faults seen without touch."""

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.gripper import FORCE_ERROR, STATE_PERIOD_s, force_share
from uniforce_vtla.errors import ContractError, RobotError
from uniforce_vtla.hand import HandRules

SEED = 20_001
RULES = HandRules()


@pytest.fixture
def started():
    env = WipeEnv("touch", drawn=(), gripper="hand")
    env.start(SEED)
    return env


def stay(env, width_m, steps):
    """Wish a width where the hand is; return both pads' load and the measured width by step."""
    felt = []
    wish = env.state.astype(np.float64)
    wish[4] = width_m
    for _ in range(steps):
        env.advance(wish)
        grips = [float(wrench[2]) for wrench in env.true_wrench().values()]
        felt.append(np.array([*grips, env.state[4]]))
    return felt


@pytest.fixture
def grasping(started):
    """One whose expert has just lifted the eraser."""
    expert = WipeExpert()
    for _ in walk(started, expert, SEED):
        if expert.phase == "carry":
            return started


def test_a_grasp_holds_by_force_whatever_the_wish_inside_is(grasping):
    wanted_N = RULES.grip_force_N * force_share(SEED)
    for width_m in (0.005, 0.015, 0.022):
        grips_N = np.array(stay(grasping, width_m, 20)[-5:])[:, :2]
        np.testing.assert_allclose(grips_N, wanted_N, rtol=0.05)


def test_a_wider_wish_opens(grasping):
    assert stay(grasping, 0.05, 40)[-1][2] == pytest.approx(0.05, abs=0.002)


def test_the_force_of_an_episode_is_its_own_and_within_the_hands_specification():
    shares = np.array([force_share(seed) for seed in range(200)])
    assert np.abs(shares - 1).max() <= FORCE_ERROR and shares.std() > FORCE_ERROR / 3
    assert force_share(7) == force_share(7)


def test_the_width_is_read_ten_times_a_second(started):
    widths = [width_m for *_, width_m in stay(started, 0.02, 30)]
    changes = np.flatnonzero(np.diff(widths))
    assert len(changes) > 3 and np.diff(changes).min() >= round(STATE_PERIOD_s * 30) - 1


def test_a_small_change_of_the_wish_moves_nothing(started):
    stay(started, 0.05, 10)
    width_m = started.sim.measured[4]
    stay(started, width_m - 0.9 * RULES.hysteresis_m, 20)
    assert started.sim.measured[4] == pytest.approx(width_m, abs=2e-4)


def test_a_dropped_tool_is_noticed_by_the_hand_itself(grasping):
    eraser = grasping.sim.model.joint("eraser").qposadr[0]
    grasping.sim.data.qpos[eraser : eraser + 3] = (0.3, 0.3, 0.1)  # somebody pulls it out
    with pytest.raises(RobotError, match="what was grasped"):
        stay(grasping, 0.01, 60)


def test_the_hand_is_the_usual_gripper():
    assert WipeEnv("touch", drawn=()).gripper == "hand"
    with pytest.raises(ContractError, match=r"servo \| hand"):
        WipeEnv("touch", drawn=(), gripper="claw")


@pytest.mark.parametrize("gripper", ["hand", "servo"])
def test_a_felt_grip_is_lifted_at_once(gripper):
    # a policy that learns from an expert which waits asks for a mean of waiting and lifting
    env = WipeEnv("touch", drawn=(), gripper=gripper)
    expert = WipeExpert()
    asked_m = []
    for _ in walk(env, expert, 5001):
        if env.true_wrench()["right"][2] > 7.5:
            asked_m.append(expert._sequence.target[2] - env.state[2])
        if len(asked_m) == 10:
            break
    assert np.mean(asked_m) > 0.004, "an arm that lags stays where it is for less"
