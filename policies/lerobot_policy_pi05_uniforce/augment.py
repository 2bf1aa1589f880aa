"""Camera pictures as another day would show them, while training: light, colours, a nudged camera.

Fifty episodes show fifty lights and fifty camera poses. A policy that learns those by heart doesn't
see in the next scene whether the hand is at the eraser (docs/experiments/tiny_policy.md). Every
sample of a batch draws for itself, which torchvision's transforms don't.
"""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import affine_grid, grid_sample


@dataclass(frozen=True)
class VariationRange:
    """Each drawn evenly per picture; about as scenes of level ``touch`` differ."""

    gain: float = 0.25  # ± log brightness
    tint: float = 0.08  # ± log gain of each colour
    contrast: float = 0.15  # ± log contrast about the picture's mean
    # ± log gain at the picture's borders, a slope in any direction: light from elsewhere
    shade: float = 0.12
    # ± of the picture's side: .015 rad of a camera that sees .9 rad, and 5 mm of .5 m
    shift: float = 0.03
    turn_rad: float = 0.03
    zoom: float = 0.02  # ± log size


TOUCH_LEVEL = VariationRange()


def vary(images: Tensor, strength: float, ranges: VariationRange = TOUCH_LEVEL) -> Tensor:
    """Return (B, 3, H, W) pictures in [-1, 1], each under its own light and camera pose.

    ``strength`` 0 leaves them as they are, 1 draws as ``ranges`` says.
    """
    if not strength:
        return images

    def drawn(spread: float, channels: int) -> Tensor:
        """Draw (B, channels, 1, 1), evenly within ± spread."""
        share = torch.rand(len(images), channels, 1, 1, device=images.device)
        return spread * strength * (2 * share - 1)

    # where the nudged camera looks, in [-1, 1]
    turn = drawn(ranges.turn_rad, 1).flatten()  # (B,)
    size = drawn(ranges.zoom, 1).flatten().exp()
    shift = drawn(2 * ranges.shift, 2)[..., 0]  # (B, 2, 1); a side is 2 long
    cos = turn.cos() * size
    sin = turn.sin() * size
    rotation = torch.stack([cos, -sin, sin, cos], dim=1).unflatten(1, (2, 2))  # (B, 2, 2)
    pose = torch.cat([rotation, shift], dim=2)  # (B, 2, 3)
    places = affine_grid(pose, list(images.shape), align_corners=False)  # (B, H, W, 2)
    moved = grid_sample(images, places, padding_mode="border", align_corners=False)
    light = (moved + 1) / 2
    mean = light.mean(dim=(1, 2, 3), keepdim=True)
    light = mean + (light - mean) * drawn(ranges.contrast, 1).exp()
    light = light * (drawn(ranges.gain, 1) + drawn(ranges.tint, 3)).exp()
    # a gain that rises along a direction of each picture's own
    height, width = images.shape[-2:]
    down = torch.linspace(-1, 1, height, device=images.device)[:, None]
    right = torch.linspace(-1, 1, width, device=images.device)
    slope = drawn(ranges.shade, 1) * down + drawn(ranges.shade, 1) * right  # (B, 1, H, W)
    return (light * slope.exp()).clamp(0, 1) * 2 - 1
