"""Pooled latents (or a true wrench) of one touch slot → K prefix tokens of the VLM's width."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

WRENCH_SCALE = (5.0, 5.0, 10.0, 100.0)  # N, N, N, Nmm: a firm wipe's shear, press and torsion become ~1


@dataclass(frozen=True)
class SuffixTouch:
    """Force tokens in front of the noisy actions: ``tokens`` (B, N, D_expert), ``mask`` (B, N) bool."""

    tokens: Tensor
    mask: Tensor


class Settled(nn.Module):
    """Standardise numbers by the mean and spread of the first batches of training, kept from then on.

    A dataset's statistics hold the spread of each latent number, not of a direction across them. Unlike batch
    normalisation, a sample never depends on its batch, and training and rollout compute the same.

    Args:
        size: how many numbers.
    """

    BATCHES = 200  # 6,400 frames at batch 32: half of the demos' episodes

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("square", torch.ones(size))
        self.register_buffer("batches", torch.zeros((), dtype=torch.int64))

    def forward(self, numbers: Tensor) -> Tensor:
        """Map (B, size) to the same, standardised."""
        if self.training:
            self._settle(numbers.detach())
        return (numbers - self.mean) / (self.square - self.mean.square()).clamp_min(1e-6).sqrt()

    def _settle(self, numbers: Tensor) -> None:
        if int(self.batches) >= self.BATCHES:
            return
        self.batches += 1
        share = 1 / int(self.batches)
        self.mean.lerp_(numbers.mean(dim=0), share)
        self.square.lerp_(numbers.square().mean(dim=0), share)


class ForceTokens(nn.Module):
    """Project each slot's touch input to K tokens; one projection for all slots, told apart by an embedding.

    The input keeps its amplitude (amplitude is force): a fixed mean per number is taken off and a fixed spread per
    channel divided out, both stored in the checkpoint, never its own. Without the mean, which is ten times what touch
    moves in a latent, a policy hardly learns to hear it. What is RMS-normalised is the outcome, after a non-linearity,
    so that force tokens enter the prefix as loud as an image patch does, whatever was felt; a learned gain takes it
    from there.

    Where ``agreed`` is above 0, all cells are first projected on that many directions on which two sensors agree
    (tokenizer/agreement.py); those few numbers are what every token of the slot hears. The rest of a latent tells more
    of the sensor than of the force.

    Args:
        input_shape: rows and numbers per row that come in: (K, latent size), or (1, 4) for a wrench.
        num_tokens: K.
        num_slots: how many slots the policy has.
        width: VLM width D.
        scale: initial RMS of a token.
        noise: spread of the Gaussian noise that training adds to each input number, in units of its spread. What
            survives it is what many cells agree on, and that is what another sensor's latents share.
        agreed: how many agreed numbers replace the cells; 0 keeps the cells.
    """

    def __init__(
        self,
        input_shape: tuple[int, int],
        num_tokens: int,
        num_slots: int,
        width: int,
        scale: float,
        noise: float = 0.0,
        agreed: int = 0,
    ) -> None:
        super().__init__()
        self.noise = noise
        self.register_buffer("input_mean", torch.zeros(input_shape))
        self.register_buffer("input_scale", torch.ones(input_shape[1]))
        self.register_buffer("directions", torch.zeros(math.prod(input_shape), agreed) if agreed else None)
        self.settled = Settled(agreed) if agreed else None
        numbers = agreed or input_shape[1]
        self.proj = nn.Sequential(nn.Linear(numbers, width), nn.GELU(), nn.Linear(width, width))
        self.cell_embedding = nn.Parameter(0.5 * torch.randn(num_tokens, width))
        self.slot_embedding = nn.Parameter(0.5 * torch.randn(num_slots, width))
        self.gain = nn.Parameter(torch.tensor(scale))

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Map (B, K or 1, input_size) to (B, K, D); one row (a wrench) is spread over all K cells."""
        felt = self._standardised(touch)
        if self.training and self.noise:
            felt = felt + self.noise * torch.randn_like(felt)
        hidden = self.proj(felt)  # (B, K or 1, D)
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]  # (B, K, D)
        return self.gain * nn.functional.rms_norm(hidden, hidden.shape[-1:])

    def _standardised(self, touch: Tensor) -> Tensor:
        """Return (B, K or 1, input_size), or (B, 1, agreed)."""
        if self.settled is None:
            return (touch - self.input_mean) / self.input_scale
        return self.settled(touch.flatten(1) @ self.directions)[:, None]


class MarkerPairTokens(nn.Module):
    """Control: marker images through a small CNN learnt with the policy, instead of the frozen tokenizer.

    Args:
        grid: K = grid² tokens.
        num_slots: how many slots the policy has.
        width: VLM width D.
        scale: initial RMS of a token.
    """

    def __init__(self, grid: int, num_slots: int, width: int, scale: float) -> None:
        super().__init__()
        sizes = (2, 32, 64, width)
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.GELU()]
        self.cnn = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(grid), nn.Conv2d(width, width, 1))
        self.cell_embedding = nn.Parameter(0.5 * torch.randn(grid**2, width))
        self.slot_embedding = nn.Parameter(0.5 * torch.randn(num_slots, width))
        self.gain = nn.Parameter(torch.tensor(scale))

    def forward(self, pair: Tensor, slot: int) -> Tensor:
        """Map (B, 2, S²) reference and current in [0, 1] to (B, K, D)."""
        side = math.isqrt(pair.shape[-1])
        hidden = self.cnn(pair.unflatten(-1, (side, side))).flatten(2).transpose(1, 2)  # (B, K, D)
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]
        return self.gain * nn.functional.rms_norm(hidden, hidden.shape[-1:])


class StateToken(nn.Module):
    """The continuous normalised state as one prefix token: text bins are too coarse to learn from few demos."""

    def __init__(self, state_size: int, width: int) -> None:
        super().__init__()
        self.proj = nn.Sequential(nn.Linear(state_size, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, state: Tensor) -> Tensor:
        """Map (B, 1, state_size) to (B, 1, D) of unit RMS."""
        hidden = self.proj(state)
        return nn.functional.rms_norm(hidden, hidden.shape[-1:])


def wrench_scale(device: torch.device | str = "cpu") -> Tensor:
    """Return the (4,) scale of the wrench input: N, N, N, Nmm."""
    return torch.tensor(WRENCH_SCALE, device=device)


def channel_spread(std: Tensor, size: int) -> Tensor:
    """Return the (size,) spread of each input channel over time, from the std of each number (rows·size,)."""
    spread = std.float().reshape(-1, size).square().mean(dim=0).sqrt()
    return spread.clamp_min(1e-3)  # a channel the tokenizer never uses must not explode
