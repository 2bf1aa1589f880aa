"""UniForce (FT): starts from the tokenizer, leaves it alone, and gets better by training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.baselines.end_to_end import EndToEndConfig
from benchmarks.baselines.finetuned import FineTuneConfig, TokenizerEncoder, finetuned_row, fit_finetuned
from benchmarks.baselines.pictures import pictures
from benchmarks.probes.zero_shot import Table, encode_set, score
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import TokenizerConfig

SHORT = EndToEndConfig(steps=3, frames_per_step=16)


def test_fine_tuning_starts_from_the_tokenizer_and_leaves_it_alone(
    table: Table, tiny: TokenizerConfig
) -> None:
    tokenizer = Tokenizer.random(tiny)
    before = {k: v.clone() for k, v in tokenizer.model.state_dict().items()}
    encoder = TokenizerEncoder(tokenizer)
    reference, frames = pictures(table.frozen["tactip"]).tensors(slice(0, 3))
    same = encode_set(tokenizer, table.frozen["tactip"])[:3]
    torch.testing.assert_close(encoder(reference, frames), same, atol=1e-5, rtol=1e-4)
    finetuned_row(table, tokenizer, 1, FineTuneConfig(SHORT))
    assert all(torch.equal(before[k], v) for k, v in tokenizer.model.state_dict().items())
    assert not any(p.requires_grad for p in tokenizer.model.parameters())


def test_fine_tuning_improves_on_the_frozen_head(table: Table, tiny: TokenizerConfig) -> None:
    source, tokenizer, unseen = table.training["gelsight"], Tokenizer.random(tiny), table.frozen["gelsight"]
    r2 = []
    for steps in (1, 80):
        training = EndToEndConfig(steps=steps, frames_per_step=32, learning_rate=1e-3, encoder_rate=1.0)
        predict = fit_finetuned(source, tokenizer, table.head, FineTuneConfig(training), seed=0)
        r2.append(np.mean(score(unseen.force_N, predict(pictures(unseen)))["r2"]))
    assert r2[1] > r2[0] and r2[1] > 0.3


def test_fine_tuning_refuses_pictures_of_another_size(table: Table, tiny: TokenizerConfig) -> None:
    other = Tokenizer.random(replace(tiny, side=64))
    with pytest.raises(ContractError, match="side 64"):
        finetuned_row(table, other, 1, FineTuneConfig(SHORT))
