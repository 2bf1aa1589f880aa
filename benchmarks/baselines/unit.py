"""UniT: the encoder of a VQGAN trained on one markered sensor; the latent before quantisation.

Key layout from the project's configuration and the VQGAN it builds on (MIT); written here with those names.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.baselines.checkpoint import Tensors, load_strictly, read_tensors
from benchmarks.baselines.frozen import (
    Brightness,
    PublishedEncoder,
    PublishedRow,
    grey_to_rgb,
    measured_row,
    missing_row,
)
from benchmarks.probes.zero_shot import Table

GROUPS = 32  # of every group norm
UNUSED = ("decoder.", "post_quant_conv.", "quantize.", "loss.")  # the other half of the file
MARKER_IMAGE_ASPECT = 480 / 640  # a square of the table is that image between black bars


@dataclass(frozen=True)
class UniTConfig:
    """Sizes; the default is the released representation's."""

    size: tuple[int, int] = (128, 160)  # input height, width [px]
    channels: int = 128  # of the first level
    # channels of a level over the first; each but the last halves
    multipliers: tuple[int, ...] = (1, 1, 2, 4)
    blocks: int = 2  # residual blocks per level
    attention_level: int = 3  # level whose blocks are followed by attention (resolution 16)
    z: int = 3  # channels of the encoder's output
    embed: int = 3  # channels of the latent


class ResBlock(nn.Module):
    """Group norm, swish, 3×3 convolution, twice; residual."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.norm1, self.conv1 = _norm(inputs), nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2, self.conv2 = _norm(outputs), nn.Conv2d(outputs, outputs, 3, padding=1)
        if inputs != outputs:
            self.nin_shortcut = nn.Conv2d(inputs, outputs, 1)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return (B, outputs, H, W)."""
        hidden = self.conv1(F.silu(self.norm1(maps)))
        hidden = self.conv2(F.silu(self.norm2(hidden)))
        return (self.nin_shortcut(maps) if hasattr(self, "nin_shortcut") else maps) + hidden


class PixelAttention(nn.Module):
    """One-head attention among all pixels of a map; residual."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm = _norm(channels)
        self.q, self.k, self.v, self.proj_out = (nn.Conv2d(channels, channels, 1) for _ in range(4))

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return (B, C, H, W)."""
        normed = self.norm(maps)
        query, key, value = (conv(normed).flatten(2).transpose(1, 2) for conv in (self.q, self.k, self.v))
        mixed = F.scaled_dot_product_attention(query, key, value)  # (B, H·W, C)
        return maps + self.proj_out(mixed.transpose(1, 2).unflatten(2, maps.shape[2:]))


class Halve(nn.Module):
    """3×3 convolution of stride 2, padded right and below only."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, stride=2)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return (B, C, H / 2, W / 2)."""
        return self.conv(F.pad(maps, (0, 1, 0, 1)))


class Level(nn.Module):
    """The residual blocks of one resolution, each followed by attention where there is any."""

    def __init__(self, config: UniTConfig, level: int) -> None:
        super().__init__()
        sizes = [config.channels * m for m in (1, *config.multipliers)]
        inputs, outputs = sizes[level], sizes[level + 1]
        self.block = nn.ModuleList(
            ResBlock(inputs if index == 0 else outputs, outputs) for index in range(config.blocks)
        )
        attends = level == config.attention_level
        self.attn = nn.ModuleList(PixelAttention(outputs) for _ in range(config.blocks * attends))
        if level < len(config.multipliers) - 1:
            self.downsample = Halve(outputs)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return the next level's input."""
        for index, block in enumerate(self.block):
            maps = block(maps)
            maps = self.attn[index](maps) if len(self.attn) else maps
        return self.downsample(maps) if hasattr(self, "downsample") else maps


class Middle(nn.Module):
    """Residual block, attention, residual block."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.block_1 = ResBlock(channels, channels)
        self.attn_1 = PixelAttention(channels)
        self.block_2 = ResBlock(channels, channels)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return (B, C, h, w)."""
        return self.block_2(self.attn_1(self.block_1(maps)))


class VQEncoder(nn.Module):
    """What stands under ``encoder.`` in the file."""

    def __init__(self, config: UniTConfig) -> None:
        super().__init__()
        last = config.channels * config.multipliers[-1]
        self.conv_in = nn.Conv2d(3, config.channels, 3, padding=1)
        self.down = nn.ModuleList(Level(config, level) for level in range(len(config.multipliers)))
        self.mid = Middle(last)
        self.norm_out = _norm(last)
        self.conv_out = nn.Conv2d(last, config.z, 3, padding=1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, z, h, w) for (B, 3, H, W)."""
        maps = self.conv_in(images)
        for level in self.down:
            maps = level(maps)
        return self.conv_out(F.silu(self.norm_out(self.mid(maps))))


class UniTEncoder(PublishedEncoder):
    """Encoder and 1×1 convolution: UniT's representation, before quantisation."""

    name = "UniT"

    def __init__(self, config: UniTConfig | None = None) -> None:
        super().__init__()
        self.config = config or UniTConfig()
        self.input_size = self.config.size
        self.encoder = VQEncoder(self.config)
        self.quant_conv = nn.Conv2d(self.config.z, self.config.embed, 1)

    def prepare(self, images: torch.Tensor, brightness: Brightness) -> torch.Tensor:
        """Return (B, 3, 128, 160) in [0, 1]: the marker image without the square's black bars, resized."""
        side = images.shape[-1]
        bar = round(side * (1 - MARKER_IMAGE_ASPECT) / 2)
        return grey_to_rgb(images[:, bar : side - bar], self.input_size)

    def token_map(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return (B, 3, 16, 20) at full size."""
        return self.quant_conv(self.encoder(inputs))


def load_unit(path: Path, config: UniTConfig | None = None) -> UniTEncoder:
    """Load encoder and ``quant_conv`` from a Lightning checkpoint.

    Raises:
        CheckpointError: missing, unreadable, or any key that doesn't fit or isn't known.
    """
    encoder = UniTEncoder(config)
    load_strictly(encoder, used_half(read_tensors(path, inside="state_dict")), str(path))
    return encoder.eval().requires_grad_(False)


def used_half(tensors: Tensors) -> Tensors:
    """Return all tensors but the decoder's, the codebook's and the training loss's."""
    return {name: value for name, value in tensors.items() if not name.startswith(UNUSED)}


def unit_row(table: Table, seeds: int, weights: Path | None, device: str = "cpu") -> PublishedRow:
    """Return UniT's row; "n/a" without a file."""
    if weights is None:
        with torch.device("meta"):
            return missing_row(UniTEncoder())
    return measured_row(load_unit(weights), table, seeds, weights.name, device)


def _norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(GROUPS, channels, eps=1e-6)
