from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.baselines.twins import (
    VQVAE,
    Kind,
    MaskedAutoencoder,
    PairSource,
    TwinConfig,
    TwinEncoder,
    train_twin,
    train_twin_with_losses,
    twin_row,
)
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.errors import ContractError
from uniforce_vtla.tokenizer.model import TokenizerConfig


@pytest.fixture
def config(tiny: TokenizerConfig) -> TwinConfig:
    return TwinConfig(model=tiny, codes=32, units_per_batch=2, pairs_per_unit=4, learning_rate=3e-3)


@pytest.mark.parametrize(("kind", "size"), [("mae", 16), ("vqvae", 3)])
def test_a_twin_trains_repeats_and_gives_features(
    kind: Kind, size: int, config: TwinConfig, pairs: PairSource, table: Table
) -> None:
    twin, losses = train_twin_with_losses(kind, pairs, 60, 0, config)
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:5])
    again = [train_twin_with_losses(kind, pairs, 3, 5, config)[1] for _ in range(2)]
    assert again[0] == again[1]
    labelled = table.frozen["tactip"]
    z = twin.features(labelled)
    assert z.shape == (8, 4, 16, size) and bool(z.isfinite().all())
    assert not any(p.requires_grad for p in twin.parameters())
    blind = replace(labelled, force_N=np.full_like(labelled.force_N, np.nan))
    assert torch.equal(twin.features(blind), z)
    assert z.flatten(0, 1).std(dim=0).mean() > 1e-3  # frames differ


def test_a_twins_row_beats_the_mean_on_its_own_sensor(
    config: TwinConfig, pairs: PairSource, table: Table
) -> None:
    twin = train_twin("mae", pairs, 40, 0, config)
    row = twin_row(table, twin, 1)
    assert set(row) == {"G->G", "G->T", "T->G", "T->T"}
    assert np.mean(row["G->G"]["r2"]) > 0.3
    with pytest.raises(ContractError, match="seeds"):
        twin_row(table, twin, 0)


def test_masked_patches_alone_are_scored_and_hidden_ones_unseen(config: TwinConfig) -> None:
    model = MaskedAutoencoder(
        replace(config, model=replace(config.model, motion_scales=0), hidden_share=0.75)
    )
    seen = []
    model.encoder.blocks.register_forward_hook(lambda module, args, out: seen.append(args[0].shape))
    image = torch.rand(2, 1, 32, 32)
    model.loss(image, image)
    assert seen == [torch.Size([2, 4, 16])]  # 4 of 16 patches reach the encoder


def test_quantised_latents_are_codes_and_pass_gradients(config: TwinConfig) -> None:
    model = VQVAE(config)
    z = torch.randn(2, 5, 3, requires_grad=True)
    codes, pull = model.quantise(z)
    gaps = (
        (z.detach().flatten(0, 1)[:, None] - model.codes.weight.detach()).square().sum(dim=2)
    )  # (10, codes)
    torch.testing.assert_close(codes.detach().flatten(0, 1), model.codes.weight[gaps.argmin(dim=1)].detach())
    codes.sum().backward(retain_graph=True)
    assert torch.equal(z.grad, torch.ones_like(z))  # type: ignore[arg-type]
    pull.backward()
    assert model.codes.weight.grad is not None and bool(model.codes.weight.grad.any())


def test_codes_start_among_the_latents_and_many_are_used(config: TwinConfig, pairs: PairSource) -> None:
    torch.manual_seed(0)
    model = VQVAE(config)
    batch = pairs.draw(np.random.default_rng(0), 1, 16)
    images = batch.left_reference.expand_as(batch.left_current), batch.left_current

    def used() -> int:
        z = model.encoder(*images).detach().flatten(0, 1)
        return len(torch.cdist(z, model.codes.weight.detach()).argmin(dim=1).unique())

    before = used()
    model.start_codes(*images)
    assert used() > max(before, config.codes // 2)


def test_bad_input_is_refused(config: TwinConfig, pairs: PairSource, table: Table) -> None:
    with pytest.raises(ContractError, match="twin: expected"):
        train_twin("gan", pairs, 1, 0, config)  # type: ignore[arg-type]
    with pytest.raises(ContractError, match="step"):
        train_twin("mae", pairs, 0, 0, config)
    larger = replace(config, model=replace(config.model, side=64))
    with pytest.raises(ContractError, match="side 64"):
        TwinEncoder(larger).features(table.frozen["tactip"])
