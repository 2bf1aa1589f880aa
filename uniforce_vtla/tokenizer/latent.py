"""Latents that carry their tokenizer's hash, since those of two look alike; pooled maps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch.nn import functional as F  # noqa: N812

from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected

POOL = 4  # regions per side of a pooled map: what heads, calibrations and policies read

# Functions that only pick, join, reshape or move numbers; every other one gives a plain tensor.
PICKS = ("__getitem__", "unbind", "cat", "stack", "unsqueeze", "squeeze", "flatten", "unflatten")
MOVES = ("reshape", "view", "expand", "contiguous", "clone", "detach", "to", "cpu", "cuda")
KEEPS_ORIGIN = frozenset((*PICKS, *MOVES))


class Latent(torch.Tensor):
    """Latents (…, P, L) float32 of one tokenizer, as ``Tokenizer.encode`` returns them.

    A tensor in all other ways.

    Attributes:
        tokenizer_hash: the ``hash`` of their tokenizer. Indexing, stacking, reshaping and moving
            keep it.
    """

    tokenizer_hash: str

    @classmethod
    def of(cls, z: torch.Tensor, tokenizer_hash: str) -> Latent:
        """Return latents that were stored as plain numbers, with the hash stored beside them."""
        latent = z.as_subclass(cls)
        latent.tokenizer_hash = tokenizer_hash
        return latent

    def __deepcopy__(self, memo: Any) -> Latent:
        return self.clone()  # torch's own needs an empty tensor of this class

    @classmethod
    def __torch_function__(
        cls, func: Callable[..., Any], types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        """Run one of torch's functions.

        Its result has an origin if all of its tensors have the same.
        """
        with torch._C.DisableTorchFunctionSubclass():
            result = func(*args, **(kwargs or {}))
        if getattr(func, "__name__", "") not in KEEPS_ORIGIN:
            return _plain(result)
        joined = args[0] if args and isinstance(args[0], (list, tuple)) else args[:1]
        origins = {getattr(z, "tokenizer_hash", "") for z in joined}
        if len(origins) == 1:
            return _of_all(result, origins.pop())
        return _plain(result)


def own_latent(z: torch.Tensor, tokenizer_hash: str, reader: str) -> torch.Tensor:
    """Return ``z`` as a plain tensor if it comes from the tokenizer that ``reader`` belongs to.

    Raises ContractError: a tensor that doesn't say where it comes from; CheckpointError: latents of
    another tokenizer.
    """
    if not isinstance(z, Latent):
        do = "Pass what Tokenizer.encode returned; stored ones become Latent.of(z, its hash)."
        raise ContractError(expected(f"latents for {reader}", "a Latent", type(z).__name__, do))
    if z.tokenizer_hash != tokenizer_hash:
        wanted = f"tokenizer {tokenizer_hash[:12]}…"
        came = f"tokenizer {z.tokenizer_hash[:12]}…"
        do = "Load both of one size or folder."
        raise CheckpointError(expected(f"latents for {reader}", wanted, came, do))
    return z.as_subclass(torch.Tensor)


def _plain(result: Any) -> Any:
    return result.as_subclass(torch.Tensor) if isinstance(result, Latent) else result


def _of_all(result: Any, origin: str) -> Any:
    if isinstance(result, Iterable) and not isinstance(result, torch.Tensor):
        return tuple(Latent.of(part, origin) for part in result)
    return Latent.of(result, origin)


def as_map(z: torch.Tensor) -> torch.Tensor:
    """Return latents (B, P, L) as a square map (B, L, g, g)."""
    if z.ndim != 3 or math.isqrt(z.shape[1]) ** 2 != z.shape[1]:
        raise ContractError(
            expected("latent", "(B, P, L), P a square", tuple(z.shape), "Use Tokenizer.encode.")
        )
    side = math.isqrt(z.shape[1])
    return z.transpose(1, 2).unflatten(2, (side, side))  # (B, L, g, g)


def pool_latent(z: torch.Tensor, grid: int = POOL) -> torch.Tensor:
    """Return (B, grid², L).

    Means over neighbouring patches of (B, P, L), with their origin if they have one.
    """
    cells = as_map(z)
    check_count("grid of pooled latents", grid, cells.shape[-1])
    pooled = F.adaptive_avg_pool2d(cells, grid).flatten(2).transpose(1, 2)
    return Latent.of(pooled, z.tokenizer_hash) if isinstance(z, Latent) else pooled
