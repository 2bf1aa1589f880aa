"""Motion channels: a least-squares guess of how far markers moved, cell by cell, at several scales.

A product of "what changed" and "which way the edge faces" is what optical flow is made of; a linear patch
embedding has no products, and learning them from equilibrium alone took longer than a laptop's patience.
"""

from __future__ import annotations

import torch
from torch.nn import functional as F  # noqa: N812

CELL_PX = 4  # side of a cell, so that a 16-pixel patch holds 4 × 4
CHANNELS = 3  # per scale: brightness gained, motion in x, motion in y
EDGE_FLOOR = 1e-3  # energy of edges below which a cell says nothing about motion


def motion_channels(reference: torch.Tensor, current: torch.Tensor, scales: int) -> torch.Tensor:
    """Return (B, 3·scales, S / 4, S / 4) from (B, 1, S, S) images; scale k looks at images halved k times."""
    maps = []
    for scale in range(scales):
        maps.append(_one_scale(reference, current, CELL_PX >> scale))
        reference, current = F.avg_pool2d(reference, 2), F.avg_pool2d(current, 2)
    return torch.cat(maps, dim=1)


def _one_scale(reference: torch.Tensor, current: torch.Tensor, cell: int) -> torch.Tensor:
    """Solve gain = −(shift · gradient) for the shift, one cell and its neighbours at a time."""
    gain = current - reference
    gx, gy = _gradients((current + reference) / 2)
    sums = torch.cat([gain, gain * gx, gain * gy, gx * gx + gy * gy], dim=1)  # (B, 4, S, S)
    sums = F.avg_pool2d(sums, cell) if cell > 1 else sums  # (B, 4, S / 4, S / 4)
    around = F.avg_pool2d(sums[:, 1:], 3, stride=1, padding=1)
    shift = -2 * around[:, :2] / (around[:, 2:] + EDGE_FLOOR)  # edges face either axis about equally often
    return torch.cat([sums[:, :1], shift], dim=1)


def _gradients(image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return central differences along x and y, zero at the rim."""
    gx = F.pad((image[..., 2:] - image[..., :-2]) / 2, (1, 1))
    gy = F.pad((image[..., 2:, :] - image[..., :-2, :]) / 2, (0, 0, 1, 1))
    return gx, gy
