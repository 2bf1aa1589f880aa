"""The linear map of a pooled latent: ridge regression towards the identity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

if TYPE_CHECKING:
    from sklearn.linear_model import Ridge

# tried by cross-validation, in units of the latent's mean variance
RIDGES = tuple(10.0**k for k in range(-4, 3))
FOLDS = 5


class LatentMap(nn.Module):
    """z' = z + weight · (z − centre) + shift over all P·L numbers of a pooled latent.

    A new one is the identity.
    """

    weight: torch.Tensor
    centre: torch.Tensor
    shift: torch.Tensor

    def __init__(self, patches: int, latent: int) -> None:
        super().__init__()
        self.patches = patches
        self.latent = latent
        numbers = patches * latent
        self.register_buffer("weight", torch.zeros(numbers, numbers))
        self.register_buffer("centre", torch.zeros(numbers))
        self.register_buffer("shift", torch.zeros(numbers))

    @classmethod
    def scaling(cls, gain: float, free: torch.Tensor) -> LatentMap:
        """Return the map z' = z + (gain − 1) · (z − free) for ``free`` (P, latent)."""
        found = cls(*free.shape)
        found.weight.copy_((gain - 1) * torch.eye(free.numel()))
        found.centre.copy_(free.flatten())
        return found.eval()

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """Return mapped latents (B, P, latent)."""
        flat = z.flatten(1)
        return (flat + (flat - self.centre) @ self.weight + self.shift).view_as(z)


def fit_map(
    z_new: torch.Tensor, z_anchor: torch.Tensor, grasps: np.ndarray | None = None
) -> tuple[LatentMap, float]:
    """Return the map from z_new to z_anchor, (n, P, latent) each, and its ridge.

    ``grasps`` (n,) numbers the grasp of each row; without it each row is a grasp of its own.
    """
    x = z_new.flatten(1).double().numpy()  # (n, P·L)
    y = z_anchor.flatten(1).double().numpy()
    ridge = _best_ridge(x, y, folds(grasp_numbers(grasps, len(x))))
    found = LatentMap(*z_new.shape[1:])
    found.weight.copy_(torch.from_numpy(_fitted(x, y, ridge).coef_.T))
    found.centre.copy_(torch.from_numpy(x.mean(axis=0)))
    found.shift.copy_(torch.from_numpy((y - x).mean(axis=0)))
    return found.eval(), ridge


def grasp_numbers(grasps: Sequence[int] | np.ndarray | None, count: int) -> np.ndarray:
    """Return (n,) numbers of grasps from 0 on; without any, each of ``count`` rows is its own."""
    if grasps is None:
        return np.arange(count)
    return np.unique(np.asarray(grasps), return_inverse=True)[1]


def folds(grasps: np.ndarray) -> np.ndarray:
    """Return (n,) the fold of each row; all rows of a grasp are in one."""
    return grasp_numbers(grasps, len(grasps)) % FOLDS


def _fitted(x: np.ndarray, y: np.ndarray, ridge: float) -> Ridge:
    """Return the regression of y − x on x (n, N), so that a large ridge leaves the identity."""
    from sklearn.linear_model import Ridge  # a second to import, and only fitting needs it

    return Ridge(ridge * len(x) * x.var(axis=0).mean()).fit(x, y - x)


def _best_ridge(x: np.ndarray, y: np.ndarray, fold: np.ndarray) -> float:
    """Return which of ``RIDGES`` leaves the smallest error on folds left out in turn."""
    if not fold.any():
        return RIDGES[0]  # a single fold: nothing can be left out

    def error(ridge: float) -> float:
        total = 0.0
        for k in np.unique(fold):
            out = fold == k
            fitted = _fitted(x[~out], y[~out], ridge)
            total += np.square(x[out] + fitted.predict(x[out]) - y[out]).sum()
        return total

    return min(RIDGES, key=error)
