"""Image encoder and force head trained together on one source sensor's labels."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.baselines.cells import Pictures, Predictor
from uniforce_vtla.tokenizer.force_head import ForceRegressor


@dataclass(frozen=True)
class EndToEndConfig:
    """How encoder and head are trained together."""

    steps: int = 600  # optimiser steps
    frames_per_step: int = 64  # frames in a batch: fewer sequences when stretches are long
    learning_rate: float = 1e-3  # of the head; AdamW, cosine to zero
    encoder_rate: float = 1.0  # the encoder's learning rate over the head's
    weight_decay: float = 0.05  # AdamW, as for heads on frozen latents
    clip_norm: float = 1.0  # of the gradient
    device: str = "cpu"  # where it trains and predicts


class EndToEnd(nn.Module):
    """An encoder with the table's own head behind it.

    The encoder gives latent maps (B, F, P, L) of references (B, 1, S, S) and frames (B, F, S, S).
    """

    def __init__(self, encoder: nn.Module, head: ForceRegressor) -> None:
        super().__init__()
        self.encoder = encoder
        self.head = head

    def forward(self, reference: torch.Tensor, frames: torch.Tensor) -> torch.Tensor:
        """Return (B, F, 3) N."""
        return self.head(self.encoder(reference, frames))


def train_end_to_end(
    model: EndToEnd, shown: Pictures, force_N: torch.Tensor, config: EndToEndConfig, seed: int
) -> list[float]:
    """Train in place on pictures and their forces (n, T, 3); return the loss of every step.

    Stretches are random, single frames included, as for heads on frozen latents.
    """
    model.to(config.device).train()
    optimizer = torch.optim.AdamW(_groups(model, config), weight_decay=config.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.steps)
    rng = np.random.default_rng(seed)
    losses = []
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)  # dropout
        for _ in range(config.steps):
            loss = _loss(model, shown, force_N, config, rng)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(model.parameters(), config.clip_norm)
            optimizer.step()
            schedule.step()
            losses.append(loss.item())
    model.eval()
    return losses


def predictor(model: EndToEnd, device: str, batch: int = 8) -> Predictor:
    """Return a function from pictures to forces (n, T, 3) N, ``batch`` sequences at a time."""

    @torch.no_grad()
    def predict(shown: Pictures) -> np.ndarray:
        said = []
        for start in range(0, len(shown.frames), batch):
            reference, frames = shown.tensors(slice(start, start + batch))
            said.append(model(reference.to(device), frames.to(device)).cpu())
        return torch.cat(said).numpy()

    return predict


def _loss(
    model: EndToEnd,
    shown: Pictures,
    force_N: torch.Tensor,
    config: EndToEndConfig,
    rng: np.random.Generator,
) -> torch.Tensor:
    n, length = shown.frames.shape[:2]
    count = int(rng.integers(1, length + 1))
    start = int(rng.integers(0, length - count + 1))
    # 2: batch norm needs company
    rows = rng.integers(n, size=max(2, config.frames_per_step // count))
    reference, frames = shown.tensors(rows, slice(start, start + count))
    said = model(reference.to(config.device), frames.to(config.device))
    scale = model.head.force_scale
    truth = force_N[rows, start : start + count].to(config.device)
    return F.smooth_l1_loss(said / scale, truth / scale, beta=0.2)


def _groups(model: EndToEnd, config: EndToEndConfig) -> list[dict[str, object]]:
    rates = {
        model.encoder: config.learning_rate * config.encoder_rate,
        model.head: config.learning_rate,
    }
    return [{"params": list(part.parameters()), "lr": rate} for part, rate in rates.items()]
