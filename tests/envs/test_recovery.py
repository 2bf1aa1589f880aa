"""An expert whose hand is pushed away comes back by its own commands, for demonstrations."""

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.sequence import Z


@pytest.fixture
def env():
    return WipeEnv("easy", drawn=())


def commands(env, push_in, by_m, fall_s=4.0):
    """Let the expert wipe scene 9001: yield phase and command, then push where ``push_in`` says."""
    expert = WipeExpert()
    done = False
    pushed_m = 0.0
    env.start(9001)
    expert.reset(env)
    while not done:
        command = expert.act(env)
        phase = expert.phase
        yield phase, command
        if push_in(phase):
            pushed_m = by_m
        executed = command.copy()
        executed[Z] += pushed_m
        pushed_m *= np.exp(-1 / (fall_s * CONTROL_HZ))
        done = env.advance(executed)


def test_an_expert_that_loses_the_board_stays_there_and_goes_down_again(env):
    phases = []
    lost = []
    for phase, target in commands(
        env, lambda phase: phase == "wipe" and phases.count("wipe") == 30, 0.03
    ):
        phases.append(phase)
        if phases.count("wipe") > 30 and phase == "lower":
            lost.append(target)
    path = np.array(lost)  # a lift of 30 mm loses the board
    assert np.ptp(path[:, :2], axis=0).max() < 0.005  # no stroke in the air
    assert path[-1, Z] < path[0, Z] - 0.005
    assert env.result().success


def test_an_expert_that_loses_a_clean_board_leaves_it(env):
    """Otherwise demos show a hand that goes down on a clean board, and a policy never stops."""
    phases = []
    for phase, _ in commands(
        env, lambda phase: phase == "wipe" and phases.count("wipe") == 30, 0.03
    ):
        phases.append(phase)
        if phases.count("wipe") == 30:
            env.sim.ink.ink[:] = 0
            env.sim.ink.version += 1
    assert "lower" not in phases[phases.index("wipe") :] and phases[-1] == "leave"
    assert phases.count("wipe") < 60 and env.result().success


def test_a_hand_pushed_back_to_the_board_while_it_leaves_pulls_the_harder_the_lower_it_is(env):
    gap_m = []
    for phase, command in commands(
        env, lambda phase: phase == "leave" and len(gap_m) < 30, -0.03, fall_s=1.0
    ):
        if phase == "leave":
            gap_m.append(float(command[Z] - env.state[Z]))
    assert len(gap_m) > 30 and max(gap_m) > 0.025
    assert env.result().success


def test_a_hand_pushed_up_in_the_air_comes_down_by_its_own_command(env):
    carry_m = env.level.layout.carry_height_m
    high = []  # commanded, measured
    for phase, command in commands(env, lambda phase: phase == "carry" and not high, 0.04):
        if phase == "carry" and env.state[Z] > carry_m + 0.015:
            high.append((float(command[Z]), float(env.state[Z])))
    commanded_m, measured_m = np.array(high).T
    assert measured_m.max() > carry_m + 0.02 and commanded_m.min() < carry_m - 0.005
    assert env.result().clean


def test_a_hand_pushed_below_its_grasp_height_comes_up_and_grips(env):
    """Without demos from there a policy that missed the grip stays below the eraser's middle."""
    grasp_m = env.level.layout.grasp_height_m
    low = []  # commanded, measured
    for phase, command in commands(env, lambda phase: phase == "close" and not low, -0.025):
        if phase == "close" and env.state[Z] < grasp_m - 0.010:
            low.append((float(command[Z]), float(env.state[Z])))
    commanded_m, measured_m = np.array(low).T
    assert measured_m.min() < grasp_m - 0.012 and commanded_m.max() > grasp_m + 0.005
    assert env.result().success
