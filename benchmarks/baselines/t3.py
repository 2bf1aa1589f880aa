"""T3-medium (Transferable Tactile Transformer, alanzjl/t3, MIT) by its published sizes: plain ViT blocks.

For its speed alone, with random weights: the official ones were never at hand, and time depends on shapes alone.
"""

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.probes.zero_shot import POOL

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
    """Multi-head self-attention."""

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
    """Two linear layers."""

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
    """A strided convolution."""

    def __init__(self, config: T3Config) -> None:
        super().__init__()
        self.proj = nn.Conv2d(3, config.width, config.patch, stride=config.patch)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D) for (B, 3, H, W)."""
        return self.proj(images).flatten(2).transpose(1, 2)


class SensorEncoder(nn.Module):
    """A sensor's own encoder."""

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
    """What all sensors share."""

    def __init__(self, config: T3Config) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(Block(config, eps=1e-5) for _ in range(config.trunk_depth))
        self.norm = nn.LayerNorm(config.width)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, 1 + P, D)."""
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)


class T3Encoder(nn.Module):
    """Encoder of one sensor and the trunk."""

    def __init__(self, config: T3Config | None = None) -> None:
        super().__init__()
        self.config = config or T3Config()
        self.encoder = SensorEncoder(self.config)
        self.trunk = Trunk(self.config)

    def token_map(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the trunk's patch tokens (B, D, 14, 14), at full size, of (B, 3, 224, 224)."""
        tokens = self.trunk(self.encoder(inputs))[:, 1:]  # (B, P, D)
        side = self.config.image // self.config.patch
        return tokens.transpose(1, 2).unflatten(2, (side, side))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, POOL², D) of grey images (B, S, S) in [0, 1]: resized, cropped, the tokens pooled as ours are."""
        larger = round(RESIZE_PX * self.config.image / 224)
        rgb = F.interpolate(images[:, None], (larger, larger), mode="bilinear", antialias=True).expand(-1, 3, -1, -1)
        start = (larger - self.config.image) // 2
        inner = slice(start, start + self.config.image)
        pooled = F.adaptive_avg_pool2d(self.token_map(rgb[..., inner, inner]), POOL)
        return pooled.flatten(2).transpose(1, 2)
