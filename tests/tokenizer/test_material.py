"""Material variables: told by others, never by the contact itself; the encoder goes without."""

from __future__ import annotations

from dataclasses import replace

import torch

from uniforce_vtla.tokenizer.losses import LossConfig
from uniforce_vtla.tokenizer.material import mean_of_others
from uniforce_vtla.tokenizer.model import TokenizerConfig, build_model
from uniforce_vtla.tokenizer.pair_cache import Pairs
from uniforce_vtla.tokenizer.pretrain import pair_loss


def test_a_contact_does_not_tell_about_itself() -> None:
    values = torch.tensor([[1.0], [2.0], [6.0], [10.0], [20.0], [60.0]])  # two units, three contacts each
    assert mean_of_others(values, 3).flatten().tolist() == [4.0, 3.5, 1.5, 40.0, 35.0, 15.0]
    assert mean_of_others(values, 1).flatten().tolist() == [0.0] * 6


def test_they_reach_the_decoder_and_learn(tiny: TokenizerConfig) -> None:
    model = build_model(replace(tiny, material=3), seed=0)
    assert model.material is not None and model.decoder.soften is not None
    side = tiny.side
    pairs = Pairs(*(torch.rand(n, 1, side, side) for n in (2, 2, 8, 8)))
    torch.manual_seed(1)
    for _ in range(2):  # the picture layer starts at zero: the first step only wakes it
        loss, _, _ = pair_loss(model, pairs, LossConfig(), 0)
        loss.backward()
        with torch.no_grad():
            for parameter in model.parameters():
                parameter -= 1e-3 * (parameter.grad if parameter.grad is not None else 0)
    assert model.material.look[0].weight.grad is not None
    assert float(model.material.look[0].weight.grad.abs().sum()) > 0
    reference, z = pairs.left_reference, torch.randn(2, tiny.num_patches, tiny.latent)
    average = model.decoder(reference, z)
    torch.testing.assert_close(model.decoder(reference, z, torch.zeros(2, 3)), average)
    assert not torch.allclose(model.decoder(reference, z, torch.ones(2, 3)), average)


def test_without_them_nothing_changes(tiny: TokenizerConfig) -> None:
    model = build_model(tiny, seed=0)
    assert model.material is None and model.decoder.soften is None
    assert "material" not in tiny.facts()
