"""A nudged expert: recoveries in the demos, corrections as labels."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.disturbance import Nudge, NudgeSettings, Push
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.sequence import Z

STILL = (0.0,) * 5


def test_a_scale_of_zero_changes_nothing() -> None:
    target = np.array([0.4, 0.1, 0.05, 0.02, 0.03], np.float32)
    assert np.array_equal(Nudge(3, 0.0).apply(target), target)


def test_offsets_have_the_spread_asked_for_and_drift_slowly() -> None:
    nudge = Nudge(0, 1.0)
    offsets = np.array([nudge.apply(np.zeros(5)) for _ in range(20_000)])
    assert np.allclose(offsets.std(axis=0), NudgeSettings().sd, rtol=0.15)
    step = np.diff(offsets, axis=0).std(axis=0)
    assert np.all(step < 0.4 * offsets.std(axis=0))


def test_an_episode_repeats_and_episodes_differ() -> None:
    def run(seed: int) -> np.ndarray:
        nudge = Nudge(seed)
        return np.array([nudge.apply(np.zeros(5)) for _ in range(20)])

    assert np.array_equal(run(1), run(1)) and not np.array_equal(run(1), run(2))


def always(by_m: float, fall_s: float = 4.0) -> Push:
    return Push((by_m, by_m), per_s=CONTROL_HZ, fall_s=fall_s)  # begins at every step


def test_lifts_begin_while_wiping_only_rise_quickly_and_wear_off() -> None:
    settings = NudgeSettings(sd=STILL, wiping=always(0.02))
    nudge = Nudge(0, 1.0, settings)
    assert not any(nudge.apply(np.zeros(5)).any() for _ in range(100))
    up = np.array([nudge.apply(np.zeros(5), "wipe") for _ in range(30)])
    assert not up[:, [0, 1, 3, 4]].any() and up[10, Z] > 0.018
    down = np.array([nudge.apply(np.zeros(5))[Z] for _ in range(10 * round(CONTROL_HZ))])
    assert np.all(np.diff(down) < 0) and 0.001 < down[-1] < 0.003  # 20 mm over e at 4 s, twice and a half


def test_lifts_leave_the_other_offsets_as_they_were() -> None:
    calm, lifted = Nudge(4), Nudge(4, settings=NudgeSettings(wiping=always(0.01)))
    for _ in range(50):
        one, other = calm.apply(np.zeros(5)), lifted.apply(np.zeros(5), "wipe")
        assert np.array_equal(np.delete(one, Z), np.delete(other, Z))
    assert other[Z] > one[Z]


def commands(env: WipeEnv, nudge: Nudge, push_in: Callable[[str], str]) -> Iterator[tuple[str, np.ndarray]]:
    """Let the expert wipe scene 9001: yield phase and command before each step, then push as ``push_in`` says."""
    expert, done = WipeExpert(), False
    env.start(9001)
    expert.reset(env)
    while not done:
        command = expert.act(env)
        phase = expert.phase
        yield phase, command
        done = env.advance(nudge.apply(command, push_in(phase)))


def test_an_expert_who_loses_the_board_stays_there_and_goes_down_again() -> None:
    env = WipeEnv("paper")
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, wiping=always(0.03)))
    phases: list[str] = []
    lost = []
    for phase, target in commands(env, nudge, lambda _: "wipe" if phases.count("wipe") == 30 else ""):
        phases.append(phase)
        if phases.count("wipe") > 30 and phase == "lower":
            lost.append(target)
    assert lost, "a lift of 30 mm loses the board"
    path = np.array(lost)
    assert np.ptp(path[:, :2], axis=0).max() < 0.005  # no stroke in the air
    assert path[-1, Z] < path[0, Z] - 0.005
    assert env.result().success


def test_an_expert_who_loses_a_clean_board_leaves_it() -> None:
    """Otherwise demos show a hand over a clean board that goes down, and a policy wipes to the end of its time."""
    env = WipeEnv("paper")
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, wiping=always(0.03)))
    phases: list[str] = []
    for phase, _ in commands(env, nudge, lambda _: "wipe" if phases.count("wipe") == 30 else ""):
        phases.append(phase)
        if phases.count("wipe") == 30:
            env.sim.ink.ink[:] = 0
            env.sim.ink.version += 1
    assert "lower" not in phases[phases.index("wipe") :] and phases[-1] == "leave"
    assert phases.count("wipe") < 60 and env.result().success


def test_a_hand_pushed_back_to_the_board_while_it_leaves_answers_by_its_own_command() -> None:
    env = WipeEnv("paper")
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, leaving=always(-0.03, fall_s=1.0)))
    gap_m: list[float] = []
    for phase, command in commands(env, nudge, lambda phase: phase if len(gap_m) < 30 else ""):
        if phase == "leave":
            gap_m.append(float(command[Z] - env.state[Z]))
    assert len(gap_m) > 30 and max(gap_m) > 0.025  # it pulls the harder the lower it is held
    assert env.result().success


def test_a_hand_pushed_up_in_the_air_is_seen_to_come_down_by_its_own_command() -> None:
    env = WipeEnv("paper")
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, in_air=always(0.04)))
    too_high_m: list[float] = []
    answered_m: list[float] = []
    for phase, command in commands(
        env, nudge, lambda phase: phase if phase == "carry" and not too_high_m else ""
    ):
        carry_m, high_m = env.level.layout.carry_height_m, float(env.state[Z])
        if phase == "carry" and high_m > carry_m + 0.015:
            too_high_m.append(high_m)
            answered_m.append(float(command[Z]))
    assert max(too_high_m) > carry_m + 0.02 and min(answered_m) < carry_m - 0.005
    assert env.result().clean


def test_a_hand_pushed_below_its_grasp_height_comes_up_and_grips() -> None:
    """Without demos from there a policy that misses the moment to grip hangs below the eraser's middle for good."""
    env = WipeEnv("paper")
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, descending=always(-0.025)))
    too_low: list[tuple[float, float]] = []  # commanded, measured
    for phase, command in commands(
        env, nudge, lambda phase: phase if phase == "close" and not too_low else ""
    ):
        grasp_m, low_m = env.level.layout.grasp_height_m, float(env.state[Z])
        if phase == "close" and low_m < grasp_m - 0.010:
            too_low.append((float(command[Z]), low_m))
    assert min(low_m for _, low_m in too_low) < grasp_m - 0.012
    assert max(command_m for command_m, _ in too_low) > grasp_m + 0.005
    assert env.result().success


def test_a_walked_expert_is_pushed_as_its_phase_says() -> None:
    class Listening(Nudge):
        heard: list[str]

        def apply(self, target: np.ndarray, phase: str = "") -> np.ndarray:
            self.heard.append(phase)
            return super().apply(target, phase)

    env, expert = WipeEnv("paper"), WipeExpert()
    nudge = Listening(1, settings=NudgeSettings(sd=STILL, in_air=always(0.04)))
    nudge.heard = []
    highest_m = max(float(env.state[Z]) for _ in walk(env, expert, 9001, nudge))
    assert {"descend", "lift", "carry"} <= set(nudge.heard)
    assert highest_m > env.level.layout.carry_height_m + 0.015
