"""T3 (Transferable Tactile Transformer): a sensor's own encoder, then a shared trunk; plain ViT blocks.

Key layout from the project's code (MIT); the blocks are written here with the names those files use.
Its own loader takes ``gs_green`` in silence for a sensor without an encoder. Here the encoder must be named.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.baselines.checkpoint import load_strictly, read_tensors
from benchmarks.baselines.frozen import (
    Brightness,
    PublishedEncoder,
    PublishedRow,
    grey_to_rgb,
    measured_row,
    missing_row,
)
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.errors import CheckpointError, expected

RESIZE_PX = 256  # shorter edge before the centre crop


@dataclass(frozen=True)
class T3Config:
    """Sizes; the default is T3-medium."""

    image: int = 224  # pixels per side after the crop
    patch: int = 16  # pixels per side
    width: int = 768  # of a token
    heads: int = 12  # attention heads
    encoder_depth: int = 3  # blocks of a sensor's encoder
    trunk_depth: int = 9  # blocks of the shared trunk
    mlp_ratio: int = 4  # hidden size of a block's MLP over width


class Attention(nn.Module):
    """Multi-head self-attention under the file's names ``qkv`` and ``proj``."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, N, D)."""
        parts = self.qkv(tokens).unflatten(2, (3, self.heads, -1))  # (B, N, 3, heads, D/heads)
        query, key, value = parts.permute(2, 0, 3, 1, 4)  # each (B, heads, N, D/heads)
        mixed = F.scaled_dot_product_attention(query, key, value)
        return self.proj(mixed.transpose(1, 2).flatten(2))


class Mlp(nn.Module):
    """Two linear layers under the file's names ``fc1`` and ``fc2``."""

    def __init__(self, width: int, ratio: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, ratio * width)
        self.fc2 = nn.Linear(ratio * width, width)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, N, D)."""
        return self.fc2(F.gelu(self.fc1(tokens)))


class Block(nn.Module):
    """A pre-norm transformer block."""

    def __init__(self, config: T3Config, eps: float) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(config.width, eps=eps)
        self.attn = Attention(config.width, config.heads)
        self.norm2 = nn.LayerNorm(config.width, eps=eps)
        self.mlp = Mlp(config.width, config.mlp_ratio)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, N, D)."""
        tokens = tokens + self.attn(self.norm1(tokens))
        return tokens + self.mlp(self.norm2(tokens))


class PatchProjection(nn.Module):
    """A strided convolution under the file's name ``proj``."""

    def __init__(self, config: T3Config) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, config.width, config.patch, stride=config.patch)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D) for (B, 3, H, W)."""
        return self.proj(images).flatten(2).transpose(1, 2)


class SensorEncoder(nn.Module):
    """What ``encoders/<sensor>.pth`` holds."""

    def __init__(self, config: T3Config) -> None:
        super().__init__()
        patches = (config.image // config.patch) ** 2
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.width))
        self.pos_embed = nn.Parameter(torch.zeros(1, patches + 1, config.width))
        self.patch_embed = PatchProjection(config)
        self.blocks = nn.ModuleList(Block(config, eps=1e-6) for _ in range(config.encoder_depth))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, 1 + P, D)."""
        patches = self.patch_embed(images)
        tokens = torch.cat([self.cls_token.expand(len(patches), -1, -1), patches], dim=1) + self.pos_embed
        for block in self.blocks:
            tokens = block(tokens)
        return tokens


class Trunk(nn.Module):
    """What ``trunk.pth`` holds."""

    def __init__(self, config: T3Config) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(Block(config, eps=1e-5) for _ in range(config.trunk_depth))
        self.norm = nn.LayerNorm(config.width)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, 1 + P, D)."""
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)


class T3Encoder(PublishedEncoder):
    """Encoder of one sensor and the trunk; tokens are the trunk's patch tokens."""

    name = "T3"

    def __init__(self, config: T3Config | None = None) -> None:
        super().__init__()
        self.config = config or T3Config()
        self.input_size = (self.config.image, self.config.image)
        self.encoder = SensorEncoder(self.config)
        self.trunk = Trunk(self.config)

    def prepare(self, images: torch.Tensor, brightness: Brightness) -> torch.Tensor:
        """Return (B, 3, 224, 224): resize, centre crop, the set's own mean and spread as T3 does per data set."""
        larger = round(RESIZE_PX * self.config.image / 224)
        rgb = grey_to_rgb(images, (larger, larger))
        start = (larger - self.config.image) // 2
        inner = slice(start, start + self.config.image)
        return (rgb[..., inner, inner] - brightness.mean) / brightness.std

    def token_map(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return (B, D, 14, 14) at full size; the class token is left out."""
        tokens = self.trunk(self.encoder(inputs))[:, 1:]  # (B, P, D)
        side = self.config.image // self.config.patch
        return tokens.transpose(1, 2).unflatten(2, (side, side))


def load_t3(folder: Path, encoder: str, config: T3Config | None = None) -> T3Encoder:
    """Load ``encoders/<encoder>.pth`` and ``trunk.pth`` from T3's folder.

    Args:
        folder: the released folder.
        encoder: whose encoder to take, e.g. ``mini``; none of them was made for marker images.
        config: sizes; T3-medium if not given.

    Raises:
        CheckpointError: no such encoder (those present are listed), a file missing, or any key that doesn't fit.
    """
    present = sorted(path.stem for path in (folder / "encoders").glob("*.pth"))
    if encoder not in present:
        raise CheckpointError(
            expected(
                f"T3 encoder in {folder}",
                f"one of {', '.join(present) or 'none present'}",
                repr(encoder),
                "Name the encoder to use; nothing is put in its place.",
            )
        )
    model = T3Encoder(config)
    path = folder / "encoders" / f"{encoder}.pth"
    load_strictly(model.encoder, read_tensors(path), str(path))
    load_strictly(model.trunk, read_tensors(folder / "trunk.pth"), str(folder / "trunk.pth"))
    return model.eval().requires_grad_(False)


def t3_row(table: Table, seeds: int, folder: Path | None, encoder: str = "", device: str = "cpu") -> PublishedRow:
    """Return T3's row; without a folder "n/a", with one the encoder must be named."""
    if folder is None:
        with torch.device("meta"):
            return missing_row(T3Encoder())
    return measured_row(load_t3(folder, encoder), table, seeds, f"{encoder} + trunk", device)
