"""Pretraining pairs drawn live, with procedural cameras, and from disk."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.tokenizer.pair_cache import LivePairs, PairCacheConfig, build_cache, draw_finger

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
    drawn = [draw_finger(rng, "gelsight", PairCacheConfig(family_share=0.5)) for _ in range(200)]
    assert 60 < sum(isinstance(s, VirtualSensor) for s in drawn) < 140
    assert all(draw_finger(rng, "uskin", PairCacheConfig(family_share=1.0)) == "uskin" for _ in range(5))
    assert draw_finger(rng, "tactip", PairCacheConfig()) == "tactip"


def lenses(family: str) -> list[float]:
    rng, config = np.random.default_rng(0), PairCacheConfig(family_share=1.0, family=family)  # type: ignore[arg-type]
    drawn = [as_virtual(draw_finger(rng, "gelsight", config)) for _ in range(300)]
    return [sensor.spec.px_per_mm[0] for sensor in drawn]


def test_wider_family_draws_what_the_first_could_not() -> None:
    first, wider = lenses("v1"), lenses("v2")
    assert min(first) >= 17 and max(first) <= 30
    assert 16 <= min(wider) < 17 and 30 < max(wider) <= 32


def test_a_cache_from_before_an_option_existed_still_fits(tmp_path: Path) -> None:
    config = PairCacheConfig(side=32, units=1, units_per_shard=1, pairs_per_unit=1)
    build_cache(tmp_path, config)
    stored = json.loads((tmp_path / "config.json").read_text())
    del stored["family"]
    (tmp_path / "config.json").write_text(json.dumps(stored))
    build_cache(tmp_path, config)
    with pytest.raises(DatasetError, match="another folder"):
        build_cache(tmp_path, replace(config, family="v2"))
