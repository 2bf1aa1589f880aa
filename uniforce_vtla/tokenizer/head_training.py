"""Train a force head on one source sensor's labelled sequences; no other sensor's label is ever seen."""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch.nn import functional as F  # noqa: N812

from uniforce_vtla.tokenizer.force_head import ForceRegressor, HeadConfig

STD_FLOOR = 0.3  # of the channel's own spread: a cell that hardly moves must not be blown up


@dataclass(frozen=True)
class HeadTrainingConfig:
    """How a head is trained."""

    head: HeadConfig = field(default_factory=HeadConfig)
    steps: int = 400  # optimiser steps
    batch: int = 64  # sequences per step
    learning_rate: float = 3e-3  # AdamW, cosine to zero
    weight_decay: float = 0.05  # AdamW; keeps to what many cells agree on
    # of an input; a channel constant on the source would else explode elsewhere
    smallest_spread: float = 1e-6
    # of the standardised input: a source's fine print doesn't transfer. .8 was chosen among .1 … 1.2 on the other
    # sensors' *training* sequences, never on a frozen set
    input_noise: float = 0.8


def train_head(z: torch.Tensor, force_N: np.ndarray, config: HeadTrainingConfig, seed: int) -> ForceRegressor:
    """Return a head fitted to latent sequences (n, T, P, L) and their forces (n, T, 3).

    Every step takes a random stretch of random length, single frames included, so that the head works with any
    history and with none.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        head = ForceRegressor(config.head)
        target = torch.from_numpy(force_N).float()
        _standardise(head, z, target, config.smallest_spread)
        rates = {"lr": config.learning_rate, "weight_decay": config.weight_decay}
        optimizer = torch.optim.AdamW(head.parameters(), **rates)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.steps)
        rng = np.random.default_rng(seed)
        spread = head.input_std.flatten(1).mean(1)  # (L,) one amount of noise per channel
        head.train()
        for _ in range(config.steps):
            frames = int(rng.integers(1, z.shape[1] + 1))
            start = int(rng.integers(0, z.shape[1] - frames + 1))
            rows, stretch = rng.integers(len(z), size=config.batch), slice(start, start + frames)
            given, wanted = z[rows][:, stretch], target[rows][:, stretch] / head.force_scale
            noisy = given + config.input_noise * spread * torch.randn_like(given)
            loss = F.smooth_l1_loss(head(noisy) / head.force_scale, wanted, beta=0.2)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return head.eval()


def _standardise(head: ForceRegressor, z: torch.Tensor, force_N: torch.Tensor, smallest: float) -> None:
    """Store the source's mean and spread per cell, and its force scale, inside the head."""
    maps = head.maps(z.flatten(0, 1))  # (n·T, L, g, g)
    std = maps.std(dim=0)
    channel = std.square().mean(dim=(1, 2), keepdim=True).sqrt()
    head.input_mean.copy_(maps.mean(dim=0))
    head.input_std.copy_(torch.maximum(std, STD_FLOOR * channel).clamp_min(smallest))
    head.force_scale.copy_(force_N.flatten(0, 1).std(dim=0))
