"""Motion channels: a least-squares estimate of marker motion, cell by cell, at several scales.

Optical flow is a product of brightness change and image gradient. A linear patch embedding has no
products, and learning them from equilibrium alone takes long.
"""

from collections.abc import Sequence

import torch
from torch.nn import functional as F  # noqa: N812

CELL_PX = 4  # side of a cell, so that a 16-pixel patch holds 4 × 4
CHANNELS = 3  # per scale: brightness gained, motion in x, motion in y
EDGE_FLOOR = 1e-3  # energy of edges below which a cell says nothing about motion


def pyramid(images: torch.Tensor, scales: int) -> list[torch.Tensor]:
    """Return (B, 1, S, S) images halved 0, 1, … times; a reference's are worth keeping."""
    levels = [images]
    for _ in range(scales - 1):
        levels.append(F.avg_pool2d(levels[-1], 2))
    return levels


def motion_channels(reference: Sequence[torch.Tensor], current: torch.Tensor) -> torch.Tensor:
    """Return (B, 3·scales, S / 4, S / 4) from a reference's ``pyramid`` and current images.

    Solves gain = −(shift · gradient) for the shift, one cell and its neighbours at a time. Channels
    of one scale lie together: gain, shift in x, shift in y. Current images are (B, 1, S, S).
    """
    sums = []
    for k, after in enumerate(pyramid(current, len(reference))):
        sums.append(_cell_means(reference[k], after, CELL_PX >> k))
    # (B, scales, 1 and 3, S / 4, S / 4)
    gain, equations = torch.stack(sums, dim=1).split([1, 3], dim=2)
    products, energy = _neighbourhood_sums(equations).split([2, 1], dim=2)
    # edges face either axis about equally often
    shift = -8 * products / (energy + 9 * 16 * EDGE_FLOOR)
    return torch.cat([gain, shift], dim=2).flatten(1, 2)


def _cell_means(reference: torch.Tensor, current: torch.Tensor, cell: int) -> torch.Tensor:
    """Return (B, 4, S / cell, S / cell): gain, gain × gradient in x and y, gradient's energy.

    The gradient is that of the mean of both images. Here it is four times that (two images, two
    pixels apart), so products are 4 × and the energy 16 × too large. The caller undoes both.
    """
    gain = current - reference
    # a gradient is the difference of a pixel's two neighbours, zero at the rim
    both = current + reference
    gx = F.pad(both[..., 2:] - both[..., :-2], (1, 1))
    gy = F.pad(both[..., 2:, :] - both[..., :-2, :], (0, 0, 1, 1))
    # (B, 4, S, S)
    means = torch.cat([gain, gain * gx, gain * gy, torch.addcmul(gx * gx, gy, gy)], dim=1)
    if cell == 1:
        return means
    height, width = means.shape[-2:]
    # two sums of slices: a pooling kernel takes longer
    rows = means.unflatten(-2, (height // cell, cell)).sum(-2)
    return rows.unflatten(-1, (width // cell, cell)).sum(-1) / cell**2


def _neighbourhood_sums(maps: torch.Tensor) -> torch.Tensor:
    """Return (..., H, W) sums over 3 × 3 cells; a pooling kernel takes three times as long."""
    wide = F.pad(maps, (1, 1, 1, 1))
    rows = wide[..., :-2, :] + wide[..., 1:-1, :] + wide[..., 2:, :]
    return rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:]
