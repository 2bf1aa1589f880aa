"""A nudged expert: recoveries in the demos, corrections as labels."""

from __future__ import annotations

import numpy as np

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.disturbance import Nudge, NudgeSettings
from lerobot_env_uniforce_wiping.sequence import Z
from lerobot_env_uniforce_wiping.simulation import CONTROL_HZ

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


def test_lifts_begin_while_wiping_only_rise_quickly_and_wear_off() -> None:
    settings = NudgeSettings(sd=STILL, lift_m=(0.02, 0.02), lifts_per_s=CONTROL_HZ)  # at every step
    nudge = Nudge(0, 1.0, settings)
    assert not any(nudge.apply(np.zeros(5)).any() for _ in range(100))
    up = np.array([nudge.apply(np.zeros(5), wiping=True) for _ in range(30)])
    assert not up[:, [0, 1, 3, 4]].any() and up[10, Z] > 0.018
    down = np.array([nudge.apply(np.zeros(5))[Z] for _ in range(10 * round(CONTROL_HZ))])
    assert np.all(np.diff(down) < 0) and 0.001 < down[-1] < 0.003  # 20 mm over e at 4 s, twice and a half


def test_lifts_leave_the_other_offsets_as_they_were() -> None:
    calm, lifted = Nudge(4), Nudge(4, settings=NudgeSettings(lifts_per_s=CONTROL_HZ))
    for _ in range(50):
        one, other = calm.apply(np.zeros(5)), lifted.apply(np.zeros(5), wiping=True)
        assert np.array_equal(np.delete(one, Z), np.delete(other, Z))
    assert other[Z] > one[Z]


def test_an_expert_who_loses_the_board_stays_there_and_goes_down_again() -> None:
    env, expert = WipeEnv("paper"), WipeExpert()
    env.start(9001)
    expert.reset(env)
    nudge = Nudge(1, settings=NudgeSettings(sd=STILL, lift_m=(0.03, 0.03), lifts_per_s=CONTROL_HZ))
    steps_wiping, lost = 0, []
    done = False
    while not done:
        target = expert.act(env)
        steps_wiping += expert.phase == "wipe"
        if steps_wiping > 30 and expert.phase == "lower":
            lost.append(target)
        done = env.advance(nudge.apply(target, wiping=steps_wiping == 30))
    assert lost, "a lift of 30 mm loses the board"
    path = np.array(lost)
    assert np.ptp(path[:, :2], axis=0).max() < 0.005  # no stroke in the air
    assert path[-1, Z] < path[0, Z] - 0.005
    assert env.result().success
