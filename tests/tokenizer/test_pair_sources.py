"""Pretraining pairs drawn live, with procedural cameras, and from disk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.tokenizer.pair_cache import LivePairs, PairCacheConfig, draw_finger

SMALL = PairCacheConfig(side=32, family_share=0.5, free_look=True, marker_loss=0.02)


def test_live_pairs_have_the_shapes_and_repeat_with_the_generator() -> None:
    def draw(config: PairCacheConfig):
        return LivePairs(config).draw(np.random.default_rng(3), units=2, pairs=3)

    one, two = draw(SMALL), draw(SMALL)
    assert one.left_reference.shape == (2, 1, 32, 32) and one.right_current.shape == (6, 1, 32, 32)
    assert bool((one.left_current == two.left_current).all())
    assert not bool((one.left_current == draw(replace(SMALL, free_look=False)).left_current).all())


def test_the_family_replaces_cameras_only_and_only_its_share() -> None:
    rng = np.random.default_rng(0)
    drawn = [draw_finger(rng, "gelsight", 0.5) for _ in range(200)]
    assert 60 < sum(isinstance(s, VirtualSensor) for s in drawn) < 140
    assert all(draw_finger(rng, "uskin", 1.0) == "uskin" for _ in range(5))
    assert draw_finger(rng, "tactip", 0.0) == "tactip"
