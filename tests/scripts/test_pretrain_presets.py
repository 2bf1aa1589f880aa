"""Presets: the shipped checkpoints' recipes, complete and overridable."""

from dataclasses import replace
from itertools import pairwise

import pytest

from uniforce_cli.pretrain import PRESETS, PretrainCommand
from uniforce_vtla.arguments import parse, read
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.settings import PairCacheConfig

FAMILY = PairCacheConfig(units=1536, seed=2, family_share=0.6, free_look=True, marker_loss=0.02)


def test_small_draws_the_whole_family_of_sensors() -> None:
    names = ("small_draw", "small_agree")
    first, second = (read(PretrainCommand, [f"preset={n}"], PRESETS)[0] for n in names)
    assert first.run.data == second.run.data == FAMILY


def test_each_stage_of_small_starts_from_what_the_one_before_left() -> None:
    names = ("small_draw", "small_agree", "small_held", "small")
    stages = [read(PretrainCommand, [f"preset={n}"], PRESETS)[0] for n in names]
    for before, after in pairwise(stages):
        assert after.run.init == f"{before.out}/tokenizer"
        assert after.run.model == before.run.model
    for held in stages[2:]:  # the same pads, but flat handles that twist them
        usual = {"flat_share": FAMILY.flat_share, "flat_torsion_arm_mm": FAMILY.flat_torsion_arm_mm}
        assert replace(held.run.data, **usual) == FAMILY


def test_nano_is_smaller_and_what_is_given_wins() -> None:
    given = ([f"preset={name}", "run.steps=7"] for name in ("small", "nano"))
    small, nano = (read(PretrainCommand, words, PRESETS)[0] for words in given)
    assert nano.run.model.width < small.run.model.width
    assert nano.run.steps == small.run.steps == 7


def test_without_a_preset_the_equilibrium_is_the_papers() -> None:
    loss = parse(PretrainCommand, [], PRESETS).run.loss
    assert (loss.equilibrium, loss.equilibrium_scale) == ("patch", "absolute")


def test_unknown_preset_names_the_known_ones() -> None:
    with pytest.raises(ContractError, match=r"nano \| small"):
        parse(PretrainCommand, ["preset=huge"], PRESETS)
