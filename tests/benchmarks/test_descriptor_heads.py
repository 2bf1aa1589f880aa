"""Heads of a scene: made-up wipes they can read, and one real wipe through the scene."""

import numpy as np
import pytest

from benchmarks.descriptor_heads import EpisodeForces, described_episodes, errors, judge, worn
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode import EpisodeTrace
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead

FRAMES = 120


def made_up(seed: int) -> EpisodeForces:
    """Descriptors that are the force itself in natural units, with a little noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(FRAMES) / 30
    press = np.interp(t, [2.0, 2.5], [0.0, rng.uniform(4, 9)])
    up = (1.0 - press) / 2 * (t > 1)
    grip = np.where(t > 0.5, rng.uniform(8, 12), 0.0)
    force = np.stack([0.3 * np.sin(3 * t), up, grip], axis=1).astype(np.float32)
    flat = np.zeros(FRAMES)
    phase = np.digitize(t, [1.2, 2.0])
    trace = EpisodeTrace(t, press, grip, grip, *[flat] * 6, phase, rated_depth_mm=(1.5, 5.0))
    true = np.concatenate([force, force], axis=1) * NATURAL_UNITS
    noise = {f: 0.01 * rng.standard_normal(true.shape) * NATURAL_UNITS for f in FINGERS}
    noisy = {f: (true + off).astype(np.float32) for f, off in noise.items()}
    sensors = {"left": "gelsight", "right": "tactip"}
    height = np.interp(t, [0.8, 1.5], [0.1, 0.2])
    return EpisodeForces(noisy, dict.fromkeys(FINGERS, force), sensors, height, (0.9, 0.9), trace)


def heads() -> dict[str, DescriptorHead]:
    lessons = worn([made_up(seed) for seed in range(8)])
    return {s: DescriptorHead.fit(s, wipes, stretch=30, steps=300) for s, wipes in lessons.items()}


def test_heads_read_what_the_descriptors_hold_and_judge_by_it() -> None:
    found = heads()
    assert set(found) == {"gelsight", "tactip"}
    cell = errors(found["tactip"], worn([made_up(100), made_up(101)])["tactip"])
    assert min(cell["r2"]) > 0.8
    row = judge(found, made_up(102))
    assert row["press_mae_N"] < 1.0
    assert row["press_above_limit"] == [False, False]


@pytest.mark.slow
def test_a_described_episode_is_a_whole_wipe_of_both_fingers() -> None:
    """One short look: the scene's own frames described, forces beside them."""
    episode = next(described_episodes("paper", range(70_500, 70_501)))
    n = len(episode.trace.time_s)
    assert episode.sensors == {"left": "gelsight", "right": "tactip"}
    for finger in FINGERS:
        described, force = episode.described[finger] / NATURAL_UNITS, episode.force_N[finger]
        assert described.shape == (n, 6) and force.shape == (n, 3)
        moved = np.abs(described - described[force[:, 2] < 0.02].mean(axis=0)).mean(axis=1)
        assert moved[force[:, 2] > 3.0].mean() > 3 * moved[force[:, 2] < 0.02].mean()
