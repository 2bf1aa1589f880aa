"""A nudged expert: recoveries in the demos, corrections as labels."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.disturbance import Nudge, NudgeSettings, Push
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.sequence import Z

STILL = (0.0,) * 5


def test_offsets_have_the_spread_asked_for_drift_slowly_and_repeat() -> None:
    def run(seed: int, steps: int, scale: float = 1.0) -> np.ndarray:
        nudge = Nudge(seed, scale)
        return np.array([nudge.apply(np.zeros(5)) for _ in range(steps)])

    offsets = run(0, 20_000)
    assert np.allclose(offsets.std(axis=0), NudgeSettings().sd, rtol=0.15)
    assert np.all(np.diff(offsets, axis=0).std(axis=0) < 0.4 * offsets.std(axis=0))
    assert np.array_equal(run(1, 20), run(1, 20)) and not np.array_equal(run(1, 20), run(2, 20))
    assert not run(3, 20, scale=0.0).any()


def always(by_m: float, fall_s: float = 4.0) -> Push:
    return Push((by_m, by_m), per_s=CONTROL_HZ, fall_s=fall_s)  # begins at every step


def test_pushes_begin_in_their_phase_only_rise_quickly_and_decay() -> None:
    nudge = Nudge(0, 1.0, NudgeSettings(sd=STILL, wiping=always(0.02)))
    assert not any(nudge.apply(np.zeros(5)).any() for _ in range(100))
    up = np.array([nudge.apply(np.zeros(5), "wipe") for _ in range(30)])
    assert not up[:, [0, 1, 3, 4]].any() and up[10, Z] > 0.018
    down = np.array([nudge.apply(np.zeros(5))[Z] for _ in range(10 * round(CONTROL_HZ))])
    assert np.all(np.diff(down) < 0) and 0.001 < down[-1] < 0.003  # 20 mm over e at 4 s, twice and a half


def test_pushes_leave_the_other_offsets_as_they_were() -> None:
    calm, pushed = Nudge(4), Nudge(4, settings=NudgeSettings(wiping=always(0.01)))
    for _ in range(50):
        one, other = calm.apply(np.zeros(5)), pushed.apply(np.zeros(5), "wipe")
        assert np.array_equal(np.delete(one, Z), np.delete(other, Z))
    assert other[Z] > one[Z]


@pytest.fixture
def env() -> WipeEnv:
    return WipeEnv("paper")


def commands(env: WipeEnv, push_in: Callable[[str], bool], **pushes: Push) -> Iterator[tuple[str, np.ndarray]]:
    """Let the expert wipe scene 9001: yield phase and command before each step, then push where ``push_in`` says."""
    expert, done, nudge = WipeExpert(), False, Nudge(1, settings=NudgeSettings(sd=STILL, **pushes))
    env.start(9001)
    expert.reset(env)
    while not done:
        command, phase = expert.act(env), expert.phase
        yield phase, command
        done = env.advance(nudge.apply(command, phase if push_in(phase) else ""))


def test_an_expert_that_loses_the_board_stays_there_and_goes_down_again(env: WipeEnv) -> None:
    phases: list[str] = []
    lost = []
    for phase, target in commands(
        env, lambda phase: phase == "wipe" and phases.count("wipe") == 30, wiping=always(0.03)
    ):
        phases.append(phase)
        if phases.count("wipe") > 30 and phase == "lower":
            lost.append(target)
    path = np.array(lost)  # a lift of 30 mm loses the board
    assert np.ptp(path[:, :2], axis=0).max() < 0.005  # no stroke in the air
    assert path[-1, Z] < path[0, Z] - 0.005
    assert env.result().success


def test_an_expert_that_loses_a_clean_board_leaves_it(env: WipeEnv) -> None:
    """Otherwise demos show a hand over a clean board that goes down, and a policy wipes to the end of its time."""
    phases: list[str] = []
    for phase, _ in commands(env, lambda phase: phase == "wipe" and phases.count("wipe") == 30, wiping=always(0.03)):
        phases.append(phase)
        if phases.count("wipe") == 30:
            env.sim.ink.ink[:] = 0
            env.sim.ink.version += 1
    assert "lower" not in phases[phases.index("wipe") :] and phases[-1] == "leave"
    assert phases.count("wipe") < 60 and env.result().success


def test_a_hand_pushed_back_to_the_board_while_it_leaves_pulls_the_harder_the_lower_it_is(env: WipeEnv) -> None:
    gap_m: list[float] = []
    for phase, command in commands(env, lambda _: len(gap_m) < 30, leaving=always(-0.03, fall_s=1.0)):
        if phase == "leave":
            gap_m.append(float(command[Z] - env.state[Z]))
    assert len(gap_m) > 30 and max(gap_m) > 0.025
    assert env.result().success


def test_a_hand_pushed_up_in_the_air_comes_down_by_its_own_command(env: WipeEnv) -> None:
    carry_m = env.level.layout.carry_height_m
    high: list[tuple[float, float]] = []  # commanded, measured
    for phase, command in commands(env, lambda phase: phase == "carry" and not high, in_air=always(0.04)):
        if phase == "carry" and env.state[Z] > carry_m + 0.015:
            high.append((float(command[Z]), float(env.state[Z])))
    commanded_m, measured_m = np.array(high).T
    assert measured_m.max() > carry_m + 0.02 and commanded_m.min() < carry_m - 0.005
    assert env.result().clean


def test_a_hand_pushed_below_its_grasp_height_comes_up_and_grips(env: WipeEnv) -> None:
    """Without demos from there a policy that misses the moment to grip hangs below the eraser's middle for good."""
    grasp_m = env.level.layout.grasp_height_m
    low: list[tuple[float, float]] = []  # commanded, measured
    for phase, command in commands(env, lambda phase: phase == "close" and not low, descending=always(-0.025)):
        if phase == "close" and env.state[Z] < grasp_m - 0.010:
            low.append((float(command[Z]), float(env.state[Z])))
    commanded_m, measured_m = np.array(low).T
    assert measured_m.min() < grasp_m - 0.012 and commanded_m.max() > grasp_m + 0.005
    assert env.result().success


def test_a_walked_expert_is_pushed_in_its_own_phases(env: WipeEnv) -> None:
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, in_air=always(0.04)))
    highest_m = max(float(env.state[Z]) for _ in walk(env, WipeExpert(), 9001, nudge))
    assert highest_m > env.level.layout.carry_height_m + 0.015
