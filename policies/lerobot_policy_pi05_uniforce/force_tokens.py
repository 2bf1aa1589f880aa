"""Pooled latents (or a true wrench) of one touch slot → K prefix tokens of the VLM's width."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from uniforce_vtla.errors import ContractError, expected

WRENCH_SCALE = (5.0, 5.0, 10.0, 100.0)  # N, N, N, Nmm: a firm wipe's shear, press and torsion become ~1


@dataclass(frozen=True)
class SuffixTouch:
    """Force tokens in front of the noisy actions: ``tokens`` (B, N, D_expert), ``mask`` (B, N) bool."""

    tokens: Tensor
    mask: Tensor


class ForceTokens(nn.Module):
    """Project each slot's touch input to K tokens; one projection for all slots, told apart by an embedding.

    The input keeps its amplitude (amplitude is force): a fixed mean per number is taken off and a fixed spread per
    channel divided out, both stored in the checkpoint, never its own. Without the mean, which is ten times what touch
    moves in a latent, a policy hardly learns to hear it. What is RMS-normalised is the outcome, after a non-linearity,
    so that force tokens enter the prefix as loud as an image patch does, whatever was felt; a learned gain takes it
    from there.

    Args:
        input_shape: rows and numbers per row that come in: (K, latent size), or (1, 4) for a wrench.
        num_tokens: K.
        num_slots: how many slots the policy has.
        width: VLM width D.
        scale: initial RMS of a token.
        noise: spread of the Gaussian noise that training adds to each input number, in units of its channel's spread.
            What survives it is what many cells agree on, and that is what another sensor's latents share. With
            ``directions``, in units of what fingers of one grasp disagree along each.
        whole: every token also holds what one network makes of the slot's whole map. Force is a sum over cells, which
            attention over tokens made cell by cell reads less exactly than a head on the map does.
        directions: hear the slot's map along so many directions only, those on which all sensors agree best
            (uniforce_vtla/tokenizer/agreed_directions.py), told to all cells alike; 0 = the whole map.
    """

    def __init__(
        self,
        input_shape: tuple[int, int],
        num_tokens: int,
        num_slots: int,
        width: int,
        scale: float,
        noise: float = 0.0,
        whole: bool = False,
        directions: int = 0,
    ) -> None:
        super().__init__()
        self.noise = noise
        self.transferred: nn.Module | None = None  # training only, with sensor_transfer: TransferredTouch
        self.needs_transfer = False
        self.register_buffer("input_mean", torch.zeros(input_shape))
        self.register_buffer("input_scale", torch.ones(input_shape[1]))
        if directions:
            self.register_buffer("directions", torch.zeros(input_shape[0] * input_shape[1], directions))
            self.register_buffer("origin", torch.zeros(directions))
            self.register_buffer("disagreement", torch.ones(directions))
        self.agreed_only = bool(directions)
        rows, numbers = (1, directions) if directions else input_shape
        self.proj = _two_layers(numbers, width)
        self.whole = _two_layers(rows * numbers, width) if whole and rows > 1 else None
        self.cell_embedding = nn.Parameter(0.5 * torch.randn(num_tokens, width))
        self.slot_embedding = nn.Parameter(0.5 * torch.randn(num_slots, width))
        self.gain = nn.Parameter(torch.full((1,), scale))  # not a scalar: FSDP shards none

    def forward(self, touch: Tensor, slot: int) -> Tensor:
        """Map (B, K or 1, input_size) to (B, K, D); one row (a wrench) is spread over all K cells."""
        if self.training and self.needs_transfer:
            touch = self._told(touch, slot)
        felt = self._felt(touch)
        if self.training and self.noise:
            felt = felt + self.noise * self._noise_unit() * torch.randn_like(felt)
        hidden = self.proj(felt)  # (B, K or 1, D)
        if self.whole is not None:
            hidden = hidden + self.whole(felt.flatten(1))[:, None]
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]  # (B, K, D)
        return self.gain * nn.functional.rms_norm(hidden, hidden.shape[-1:])

    def _felt(self, touch: Tensor) -> Tensor:
        if self.agreed_only:
            return (touch.flatten(1) @ self.directions - self.origin)[:, None]  # (B, 1, directions)
        return (touch - self.input_mean) / self.input_scale

    def _noise_unit(self) -> Tensor | float:
        return self.disagreement if self.agreed_only else 1.0

    def _told(self, touch: Tensor, slot: int) -> Tensor:
        if self.transferred is None:
            do = "Give the policy its dataset_meta, or set policy.sensor_transfer=0."
            raise ContractError(expected("sensor_transfer", "maps, found by a view's sensors", "no view", do))
        told: Tensor = self.transferred(touch, slot)
        return told


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
        self.gain = nn.Parameter(torch.full((1,), scale))  # not a scalar: FSDP shards none

    def forward(self, pair: Tensor, slot: int) -> Tensor:
        """Map (B, 2, S²) reference and current in [0, 1] to (B, K, D)."""
        side = math.isqrt(pair.shape[-1])
        hidden = self.cnn(pair.unflatten(-1, (side, side))).flatten(2).transpose(1, 2)  # (B, K, D)
        hidden = hidden + self.cell_embedding + self.slot_embedding[slot]
        return self.gain * nn.functional.rms_norm(hidden, hidden.shape[-1:])


def _two_layers(size: int, width: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(size, width), nn.GELU(), nn.Linear(width, width))


def wrench_scale(device: torch.device | str = "cpu") -> Tensor:
    """Return the (4,) scale of the wrench input: N, N, N, Nmm."""
    return torch.tensor(WRENCH_SCALE, device=device)


def channel_spread(std: Tensor, size: int) -> Tensor:
    """Return the (size,) spread of each input channel over time, from the std of each number (rows·size,)."""
    spread = std.float().reshape(-1, size).square().mean(dim=0).sqrt()
    return spread.clamp_min(1e-3)  # a channel the tokenizer never uses must not explode
