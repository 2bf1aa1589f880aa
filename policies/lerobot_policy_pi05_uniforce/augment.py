"""Camera pictures as another day would show them, while training: light, colours, and a camera that was nudged.

Fifty episodes show fifty lights and fifty camera poses. A policy that learns those by heart doesn't see in the next
scene whether the hand is at the eraser or which row is still dirty (docs/experiments/tiny_policy.md). Not torchvision's
transforms, which draw once for a whole batch: here every sample of a batch gets its own.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample


@dataclass(frozen=True)
class VariationRange:
    """Each drawn evenly per picture; about what level ``touch`` draws per scene, so doubled with it."""

    gain: float = 0.25  # ± log brightness
    tint: float = 0.08  # ± log gain of each colour
    contrast: float = 0.15  # ± log contrast about the picture's mean
    # ± log gain at the picture's borders, a slope in any direction: light from elsewhere
    shade: float = 0.12
    # ± of the picture's side: .015 rad of a camera that sees .9 rad, and 5 mm of .5 m
    shift: float = 0.03
    turn_rad: float = 0.03
    zoom: float = 0.02  # ± log size


def vary(images: Tensor, strength: float, ranges: VariationRange | None = None) -> Tensor:
    """Return (B, 3, H, W) pictures in [-1, 1], each under a light and from a camera pose of its own.

    ``strength`` 0 leaves them as they are, 1 draws as ``ranges`` says.
    """
    if not strength:
        return images
    r = ranges or VariationRange()
    moved = grid_sample(
        images, _places(images, r, strength), padding_mode="border", align_corners=False
    )
    light = (moved + 1) / 2
    mean = light.mean(dim=(1, 2, 3), keepdim=True)
    light = mean + (light - mean) * _drawn(images, r.contrast * strength, 1).exp()
    light = (
        light * (_drawn(images, r.gain * strength, 1) + _drawn(images, r.tint * strength, 3)).exp()
    )
    return (light * _shade(images, r.shade * strength)).clamp(0, 1) * 2 - 1


def _drawn(images: Tensor, spread: float, channels: int) -> Tensor:
    """Draw (B, channels, 1, 1), evenly within ± spread."""
    return spread * (2 * torch.rand(len(images), channels, 1, 1, device=images.device) - 1)


def _places(images: Tensor, r: VariationRange, strength: float) -> Tensor:
    """Return the (B, H, W, 2) places in [-1, 1] at which the nudged camera looks."""
    turn, zoom = (_drawn(images, s * strength, 1).flatten() for s in (r.turn_rad, r.zoom))
    shift = _drawn(images, 2 * r.shift * strength, 2)[..., 0]  # (B, 2, 1); a side is 2 long
    cos, sin = turn.cos() * zoom.exp(), turn.sin() * zoom.exp()
    # (B, 2, 2)
    rotation = torch.stack([torch.stack([cos, -sin], 1), torch.stack([sin, cos], 1)], 1)
    return affine_grid(torch.cat([rotation, shift], 2), list(images.shape), align_corners=False)


def _shade(images: Tensor, spread: float) -> Tensor:
    """Return (B, 1, H, W) gains that rise along a direction of each picture's own."""
    height, width = images.shape[-2:]
    down = torch.linspace(-1, 1, height, device=images.device)[:, None]
    right = torch.linspace(-1, 1, width, device=images.device)[None, :]
    return (_drawn(images, spread, 1) * down + _drawn(images, spread, 1) * right).exp()
