"""An expert whose hand is pushed away comes back by its own commands, for demonstrations."""

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.sequence import Z


@pytest.fixture
def env():
    return WipeEnv("easy", drawn=(), gripper="servo")  # the hand closes later: time runs out


def pushed(env, where, steps, by_m, fall_s=4.0, clean=False):
    """Let the expert wipe scene 9001, pushed in some steps of a phase.

    Return the phase, the command (n, 5) and the measured height (n,) of each step. ``clean``: the
    ink goes with the push.
    """
    expert = WipeExpert()
    done = False
    pushed_m = 0.0
    phases = []
    commands = []
    heights_m = []
    env.start(9001)
    expert.reset(env)
    while not done:
        executed = expert.act(env)
        commands.append(executed.copy())
        heights_m.append(env.state[Z])
        if expert.phase == where and phases.count(where) in steps:
            pushed_m = by_m
            if clean:
                env.sim.ink.ink[:] = 0
                env.sim.ink.version += 1
        phases.append(expert.phase)
        executed[Z] += pushed_m
        pushed_m *= np.exp(-1 / (fall_s * CONTROL_HZ))
        done = env.advance(executed)
    return np.array(phases), np.array(commands), np.array(heights_m)


def test_an_expert_that_loses_the_board_stays_there_and_goes_down_again(env):
    phases, commands, _ = pushed(env, "wipe", [29], 0.03)
    after = np.cumsum(phases == "wipe") >= 30
    path = commands[after & (phases == "lower")]  # a lift of 30 mm loses the board
    assert np.ptp(path[:, :2], axis=0).max() < 0.005  # no stroke in the air
    assert path[-1, Z] < path[0, Z] - 0.005
    assert env.result().success


def test_an_expert_that_loses_a_clean_board_leaves_it(env):
    """Otherwise demos show a hand that goes down on a clean board, and a policy never stops."""
    phases, *_ = pushed(env, "wipe", [29], 0.03, clean=True)
    wiping = phases == "wipe"
    assert "lower" not in phases[wiping.argmax() :] and phases[-1] == "leave"
    assert wiping.sum() < 60 and env.result().success


def test_a_hand_pushed_back_to_the_board_while_it_leaves_pulls_the_harder_the_lower_it_is(env):
    phases, commands, heights_m = pushed(env, "leave", range(29), -0.03, fall_s=1.0)
    gap_m = (commands[:, Z] - heights_m)[phases == "leave"]
    assert len(gap_m) > 30 and gap_m.max() > 0.025
    assert env.result().success


def test_a_hand_pushed_up_in_the_air_comes_down_by_its_own_command(env):
    carry_m = env.level.layout.carry_height_m
    phases, commands, heights_m = pushed(env, "carry", range(13), 0.04)
    high = (phases == "carry") & (heights_m > carry_m + 0.015)
    assert heights_m[high].max() > carry_m + 0.02
    assert commands[high, Z].min() < carry_m - 0.005
    assert env.result().clean


def test_a_hand_pushed_below_its_grasp_height_comes_up_and_grips(env):
    """Without demos from there a policy that missed the grip stays below the eraser's middle."""
    grasp_m = env.level.layout.grasp_height_m
    phases, commands, heights_m = pushed(env, "close", range(13), -0.025)
    low = (phases == "close") & (heights_m < grasp_m - 0.010)
    assert heights_m[low].min() < grasp_m - 0.012
    assert commands[low, Z].max() > grasp_m + 0.005
    assert env.result().success
