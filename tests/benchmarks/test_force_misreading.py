"""Newtons a policy misreads: a policy made up to misread comes out as it was made."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.force_misreading import SITUATIONS, Changes, misreading, response
from uniforce_vtla.errors import DatasetError, RolloutError

SLOPES = np.array([[0.0, 0.01], [-0.4, 0.002], [0.03, 0.05], [0.001, 0.0]])  # mm per N, N, N, Nmm
EPISODES, MOMENTS = 30, 12


def changes(seed: int, slopes: np.ndarray = SLOPES, offset_mm: tuple[float, float] = (0.0, 0.0)) -> Changes:
    rng = np.random.default_rng(seed)
    wrench = rng.standard_normal((EPISODES * MOMENTS, 4)) * (1, 1, 1, 30)
    noise_mm = rng.standard_normal((len(wrench), 2)) * (0.02, 0.003)
    return Changes(wrench @ slopes + offset_mm + noise_mm, wrench, np.repeat(np.arange(EPISODES), MOMENTS))


def test_slopes_are_found() -> None:
    found = response(changes(0))
    np.testing.assert_allclose(found.slopes, SLOPES, atol=0.004)
    assert found.of("press") == pytest.approx(0.4, abs=0.01) and found.of("grip") == pytest.approx(
        0.05, abs=0.002
    )


def test_a_bias_and_a_weaker_response_are_found() -> None:
    learnt = response(changes(0))
    same = changes(1, offset_mm=(0.4 * 0.5, -0.05 * 0.8))  # believes in .5 N more press, .8 N less grip
    weaker = SLOPES * (1, 0.6)
    found = misreading(same, changes(2, weaker), learnt)
    assert found["press"].mean_N == pytest.approx(0.5, abs=0.02)
    assert found["grip"].mean_N == pytest.approx(-0.8, abs=0.03)
    assert found["press"].slope_ratio == pytest.approx(1, abs=0.03) and found[
        "grip"
    ].slope_ratio == pytest.approx(0.6, abs=0.03)
    assert found["press"].rms_N > abs(found["press"].mean_N) > found["press"].between_episodes_N


def test_what_differs_from_episode_to_episode_is_separated() -> None:
    plain, rng = changes(3), np.random.default_rng(4)
    own_N = rng.standard_normal(EPISODES)  # each episode's own error of press
    moved = plain.moves_mm + np.c_[0.4 * own_N[plain.episode], np.zeros(len(plain.episode))]
    found = misreading(Changes(moved, plain.wrench, plain.episode), changes(5), response(changes(0)))
    assert found["press"].between_episodes_N == pytest.approx(own_N.std(), abs=0.05)
    assert found["grip"].between_episodes_N < 0.05


def test_too_few_moments_and_a_policy_that_does_not_answer_are_refused() -> None:
    few = changes(0)
    with pytest.raises(DatasetError, match="moments"):
        response(Changes(few.moves_mm[:9], few.wrench[:9], few.episode[:9]))
    reversed_grip = response(changes(0, SLOPES * (1, -1)))
    with pytest.raises(RolloutError, match="grip"):
        misreading(changes(1), changes(2), reversed_grip)
    assert list(misreading(changes(1), changes(2), reversed_grip, ["press"])) == ["press"]


def test_every_moment_is_of_one_situation_at_most() -> None:
    wrench = np.random.default_rng(0).uniform((-2, -6, 0, -50), (2, 6, 13, 50), (2000, 4))
    meant = np.array([situation.meant(wrench) for situation in SITUATIONS.values()])
    assert (meant.sum(axis=0) <= 1).all() and (meant.sum(axis=1) > 50).all()
