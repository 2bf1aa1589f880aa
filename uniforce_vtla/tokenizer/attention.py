"""Transformer parts: attention over patches, causal attention over two frames, sinusoidal codes."""

import math

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812


class MultiHead(nn.Module):
    """Projections of multi-head attention over (B, P, D) tokens."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def split(self, tokens: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return query, key and value of normalised tokens, (B, P, heads, D/heads) each."""
        return self.qkv(self.norm(tokens)).unflatten(2, (3, self.heads, -1)).unbind(2)


class SpatialAttention(MultiHead):
    """Self-attention among the patches of one frame."""

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D) tokens after attention and residual."""
        query, key, value = self.split(tokens)
        mixed = F.scaled_dot_product_attention(
            query.transpose(1, 2), key.transpose(1, 2), value.transpose(1, 2)
        )  # (B, heads, P, D/heads)
        return tokens + self.out(mixed.transpose(1, 2).flatten(2))


class CausalPairAttention(MultiHead):
    """Attention of each patch over two frames: the reference sees itself, the current one both.

    A softmax over the two rows of a lower-triangular 2×2 mask needs no kernel: the first row is 1,
    the second a sigmoid of the difference of its scores. Generic kernels are slow on thousands of
    sequences of length 2.
    """

    def reference(
        self, tokens: torch.Tensor
    ) -> tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor]]:
        """Return reference tokens (B, P, D) and their (key, value) for the current frame."""
        _, key, value = self.split(tokens)
        return tokens + self.out(value.flatten(2)), (key, value)

    def current(
        self, tokens: torch.Tensor, past: tuple[torch.Tensor, torch.Tensor]
    ) -> torch.Tensor:
        """Return current tokens (B, P, D), given the reference's (key, value)."""
        query, key, value = self.split(tokens)  # each (B, P, heads, D/heads)
        past_key, past_value = past
        scale = query.shape[-1] ** -0.5
        advantage = (query * (past_key - key)).sum(-1, keepdim=True) * scale  # (B, P, heads, 1)
        mixed = value + torch.sigmoid(advantage) * (past_value - value)
        return tokens + self.out(mixed.flatten(2))


class FeedForward(nn.Module):
    """LayerNorm, two linear layers with GELU, residual."""

    def __init__(self, width: int, ratio: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.LayerNorm(width),
            nn.Linear(width, ratio * width),
            nn.GELU(),
            nn.Linear(ratio * width, width),
        )

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D)."""
        return tokens + self.layers(tokens)


def sinusoid(positions: torch.Tensor, width: int) -> torch.Tensor:
    """Return the (N, width) sine-cosine code of (N,) positions; ``width`` is even."""
    rates = torch.exp(-math.log(10_000.0) * torch.arange(0, width, 2) / width)  # (width / 2,)
    angles = positions.float()[:, None] * rates
    return torch.cat([angles.sin(), angles.cos()], dim=1)


def grid_code(grid: int, width: int) -> torch.Tensor:
    """Return the (grid², width) code of patches by row and column, half the width each."""
    axis = sinusoid(torch.arange(grid), width // 2)  # (grid, width / 2)
    rows = axis[:, None].expand(grid, grid, -1)
    return torch.cat([rows, rows.transpose(0, 1)], dim=-1).reshape(grid * grid, width)
