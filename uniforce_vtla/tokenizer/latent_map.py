"""The linear map of a pooled latent: ridge regression towards the identity, in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

# tried by cross-validation, in units of the latent's mean variance
RIDGES = tuple(10.0**k for k in range(-4, 3))
FOLDS = 5


class LatentMap(nn.Module):
    """z' = z + weight · (z − centre) + shift over all P·L numbers of a pooled latent; starts as the identity."""

    weight: torch.Tensor
    centre: torch.Tensor
    shift: torch.Tensor

    def __init__(self, patches: int, latent: int) -> None:
        super().__init__()
        self.patches, self.latent, numbers = patches, latent, patches * latent
        for name, shape in {
            "weight": (numbers, numbers),
            "centre": (numbers,),
            "shift": (numbers,),
        }.items():
            self.register_buffer(name, torch.zeros(shape))

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """Return mapped latents (B, P, latent)."""
        flat = z.flatten(1)
        return (flat + (flat - self.centre) @ self.weight + self.shift).view_as(z)


def fit_map(
    z_new: torch.Tensor, z_anchor: torch.Tensor, grasps: np.ndarray | None = None
) -> tuple[LatentMap, float]:
    """Return the map from (n, P, latent) to (n, P, latent) of the same grasps, and its ridge.

    ``grasps`` (n,) numbers the grasp that a row is of; None where each row is one of its own, in random order.
    """
    x, y = (z.flatten(1).double() for z in (z_new, z_anchor))
    ridge = _best_ridge(x, y, torch.from_numpy(folds(grasp_numbers(grasps, len(x)))))
    found = LatentMap(*z_new.shape[1:])
    for name, value in zip(("weight", "centre", "shift"), _ridge_map(x, y, ridge), strict=True):
        getattr(found, name).copy_(value)
    return found.eval(), ridge


def grasp_numbers(grasps: Sequence[int] | np.ndarray | None, count: int) -> np.ndarray:
    """Return (n,) numbers of grasps from 0 on; without any, each of ``count`` rows is a grasp of its own."""
    return (
        np.arange(count)
        if grasps is None
        else np.unique(np.asarray(grasps), return_inverse=True)[1]
    )


def folds(grasps: np.ndarray) -> np.ndarray:
    """Return (n,) the fold of each row; all rows of a grasp are in one."""
    return grasp_numbers(grasps, len(grasps)) % FOLDS


def _ridge_map(
    x: torch.Tensor, y: torch.Tensor, ridge: float
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return weight (N, N), centre (N,) and shift (N,) that bring x (n, N) to y; ``ridge`` holds weight at 0."""
    centre, shift = x.mean(dim=0), (y - x).mean(dim=0)
    around = x - centre
    covariance = around.T @ around / len(x)
    held = ridge * covariance.diagonal().mean() * torch.eye(len(covariance), dtype=x.dtype)
    target = around.T @ (y - x - shift) / len(x)
    return torch.linalg.solve(covariance + held, target), centre, shift


def _best_ridge(x: torch.Tensor, y: torch.Tensor, fold: torch.Tensor) -> float:
    """Return which of ``RIDGES`` leaves the smallest error on folds left out in turn."""

    def error(ridge: float) -> float:
        total = 0.0
        for k in range(FOLDS):
            weight, centre, shift = _ridge_map(x[fold != k], y[fold != k], ridge)
            left_out = x[fold == k]
            total += float(
                (left_out + (left_out - centre) @ weight + shift - y[fold == k]).square().sum()
            )
        return total

    return min(RIDGES, key=error)
