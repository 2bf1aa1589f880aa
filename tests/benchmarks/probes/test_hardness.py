"""The hardness chart: one thing taken away at a time; the oracle errs by gain and creep alone."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.probes.hard_sets import HETERO_HARD, HardSettings, draw_hard
from benchmarks.probes.hardness import draw_hardness, hardness, oracle, variants
from benchmarks.probes.labelled_set import LabelledSet
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.head_training import HeadTrainingConfig
from uniforce_vtla.tokenizer.settings import TokenizerConfig


def test_variants_take_one_thing_away() -> None:
    found = variants()
    full = found.pop("nothing")
    found.pop("all of it")
    for name, recipe in found.items():
        changed = {f.name for f in fields(HardSettings) if getattr(recipe, f.name) != getattr(full, f.name)}
        assert len(changed - {"name"}) == 1, name
    assert len({recipe.name for recipe in variants().values()}) == len(variants())


def test_oracle_knows_all_but_gain_and_creep() -> None:
    small = replace(HETERO_HARD, sequences=24)
    floor = oracle(small)
    assert all(0.8 < r2 < 1 for r2 in floor["r2"]) and floor["mae_N_paper_range"][2] > 0.1
    known = oracle(replace(small, unit_strength=0.0, creep_share=(0.0, 0.0)))
    assert known["r2"] == pytest.approx([1, 1, 1], abs=1e-6)


def test_chart_has_transfers_and_self_for_every_variant_and_is_drawn(tmp_path: Path) -> None:
    tokenizer = Tokenizer.random(TokenizerConfig(side=64, width=16, depth=1, heads=2, embed_hidden=0))
    easy = replace(
        HETERO_HARD, sequences=3, length=4, canonicalise=False, sequences_per_unit=3, unit_strength=0.5
    )

    def draw(recipe: HardSettings) -> dict[str, LabelledSet]:
        kept = replace(easy, name=recipe.name)
        return {name: draw_hard(kept, as_virtual(name), 64) for name in ("tactip", "uskin")}

    content = hardness(tokenizer, draw(easy), draw, seeds=1, head=HeadTrainingConfig(steps=4))
    assert set(content["without"]) == set(variants())
    for found in content["without"].values():
        assert np.isfinite(found["transfers"]["mae_N"]).all() and len(found["self"]["r2"]) == 3
    assert draw_hardness(content, tmp_path / "new" / "chart.png").stat().st_size > 10_000
