"""The scene head: made-up wipes it can read, and one real wipe through the scene and the tokenizer."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from uniforce_vtla.commands.scene_head import (
    POOL,
    FeltEpisode,
    errors,
    felt_episodes,
    fit,
    judge,
)
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.evaluation.episode import EpisodeTrace
from uniforce_vtla.tokenizer.api import Tokenizer

FRAMES = 120


def made_up(seed: int) -> FeltEpisode:
    """Latents that are the force itself, spread over the patches, with a little noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(FRAMES) / 30
    press = np.interp(t, [2.0, 2.5], [0.0, rng.uniform(4, 9)])
    up = (1.0 - press) / 2 * (t > 1)
    grip = np.where(t > 0.5, rng.uniform(8, 12), 0.0)
    force = np.stack([0.3 * np.sin(3 * t), up, grip], axis=1).astype(np.float32)
    flat = np.zeros(FRAMES)
    trace = EpisodeTrace(
        t,
        press,
        grip,
        grip,
        flat,
        flat,
        flat,
        flat,
        flat,
        np.digitize(t, [1.2, 2.0]),
        rated_depth_mm=(1.5, 5.0),
    )
    z = np.concatenate([force, force], axis=1)[:, None] * np.ones((1, POOL**2, 1))
    noisy = {f: torch.from_numpy(z + 0.01 * rng.standard_normal(z.shape)).float() for f in FINGERS}
    sensors = {"left": "gelsight", "right": "tactip"}
    height = np.interp(t, [0.8, 1.5], [0.1, 0.2])
    return FeltEpisode(noisy, dict.fromkeys(FINGERS, force), sensors, height, (0.9, 0.9), trace)


def test_a_head_reads_what_the_latents_tell_and_judges_by_it() -> None:
    torch.manual_seed(0)
    head = fit([made_up(seed) for seed in range(8)], stretch=30, steps=300)
    cells = errors(head, [made_up(100), made_up(101)])
    assert set(cells) == {"gelsight", "tactip"}
    assert min(cells["tactip"]["r2"]) > 0.8
    row = judge(head, made_up(102))
    assert row["press_mae_N"] < 1.0
    assert row["press_above_limit"] == [False, False]


@pytest.mark.slow
def test_a_felt_episode_is_a_whole_wipe_of_both_fingers() -> None:
    """One short look: the scene's own frames, latents of both sensors, forces beside them."""
    episode = next(felt_episodes("paper", range(70_500, 70_501), Tokenizer.from_pretrained("nano")))
    n = len(episode.trace.time_s)
    assert episode.sensors == {"left": "gelsight", "right": "tactip"}
    for finger in FINGERS:
        assert episode.latent[finger].shape == (n, POOL**2, 6) and episode.force_N[finger].shape == (n, 3)
        force, z = episode.force_N[finger], episode.latent[finger]
        free = z[force[:, 2] < 0.02]
        moved = (z - free.mean(dim=0)).abs().mean(dim=(1, 2)).numpy()
        assert moved[force[:, 2] > 3.0].mean() > 3 * moved[force[:, 2] < 0.02].mean()
