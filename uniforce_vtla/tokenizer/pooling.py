"""Latent maps on a coarser grid: what a policy keeps."""

from __future__ import annotations

import math

import torch
from torch.nn import functional as F  # noqa: N812

from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.latent import Latent

POOL = 4  # regions per side of a pooled map: what heads, calibrations and policies read


def as_map(z: torch.Tensor) -> torch.Tensor:
    """Return latents (B, P, L) as a square map (B, L, g, g)."""
    if z.ndim != 3 or math.isqrt(z.shape[1]) ** 2 != z.shape[1]:
        raise ContractError(
            expected("latent", "(B, P, L), P a square", tuple(z.shape), "Use Tokenizer.encode.")
        )
    side = math.isqrt(z.shape[1])
    return z.transpose(1, 2).unflatten(2, (side, side))  # (B, L, g, g)


def pool_latent(z: torch.Tensor, grid: int = POOL) -> torch.Tensor:
    """Return (B, grid², L): means over neighbouring patches of (B, P, L), with their origin if they have one."""
    cells = as_map(z)
    check_count("grid of pooled latents", grid, cells.shape[-1])
    pooled = F.adaptive_avg_pool2d(cells, grid).flatten(2).transpose(1, 2)
    return Latent.of(pooled, z.tokenizer_hash) if isinstance(z, Latent) else pooled
