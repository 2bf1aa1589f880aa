"""A nudged expert: recoveries in the demos, corrections as labels."""

from __future__ import annotations

import numpy as np

from lerobot_env_uniforce_wiping.disturbance import Nudge, NudgeSettings


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
