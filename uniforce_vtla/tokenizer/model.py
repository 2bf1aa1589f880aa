"""The conditional VAE: (reference, current) marker images → latent force map → current image again.

UniForce paper, section "Architecture". Encoder = inverse dynamics, decoder = forward dynamics given
a reference.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from uniforce_vtla.tokenizer.attention import (
    CausalPairAttention,
    FeedForward,
    SpatialAttention,
    grid_code,
    sinusoid,
)
from uniforce_vtla.tokenizer.motion import CELL_PX, CHANNELS, motion_channels, pyramid
from uniforce_vtla.tokenizer.settings import TokenizerConfig

START_LOG_VARIANCE = -4.0  # σ ≈ 0.14
FLOW_PX = 2.0  # shift of one unit of the flow head: about a strong shear on a GelSight at 128 px
LOG_VARIANCE_RANGE = (-10.0, 4.0)  # keeps exp() finite however training goes


class Posterior(NamedTuple):
    """Diagonal Gaussian over the latent force map.

    ``mean`` and ``log_variance``, each (B, P, latent).
    """

    mean: torch.Tensor
    log_variance: torch.Tensor

    def sample(self) -> torch.Tensor:
        """Return μ + σ·ε, (B, P, latent)."""
        return self.mean + torch.exp(0.5 * self.log_variance) * torch.randn_like(self.mean)


class ReferenceCache(NamedTuple):
    """Tensors of a reference that encoding a current frame needs."""

    image: torch.Tensor  # (B, 1, S, S) prepared reference
    halved: list[torch.Tensor]  # the same at every scale of the motion channels; empty without them
    # per encoder block its key and value, (B, P, heads, D/heads) each
    kept: list[tuple[torch.Tensor, torch.Tensor]]

    def repeat(self, times: int) -> ReferenceCache:
        """Return the cache with every reference repeated ``times`` times in a row."""
        kept = [
            (k.repeat_interleave(times, 0), v.repeat_interleave(times, 0)) for k, v in self.kept
        ]
        halved = [level.repeat_interleave(times, 0) for level in self.halved]
        return ReferenceCache(self.image.repeat_interleave(times, 0), halved, kept)


def patches(maps: torch.Tensor, side: int) -> torch.Tensor:
    """Cut (B, C, H, W) into patches, (B, P, C·side²), row by row.

    What ``F.unfold`` returns, but contiguous: a linear layer reads a transposed input at a third of
    the speed.
    """
    B, C, H, W = maps.shape
    cut = maps.reshape(B, C, H // side, side, W // side, side).permute(0, 2, 4, 1, 3, 5)
    return cut.reshape(B, -1, C * side**2)


class PatchEmbed(nn.Module):
    """Cut (B, 1, S, S) into patches, project each to a token, add where it is."""

    position: torch.Tensor

    def __init__(self, config: TokenizerConfig, hidden: int = 0) -> None:
        super().__init__()
        self.patch = config.patch
        pixels = config.patch**2
        self.project: nn.Module = nn.Linear(pixels, config.width)
        if hidden:
            self.project = nn.Sequential(
                nn.Linear(pixels, hidden), nn.GELU(), nn.Linear(hidden, config.width)
            )
        self.register_buffer("position", grid_code(config.grid, config.width), persistent=False)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D)."""
        return self.project(patches(images, self.patch)) + self.position


class MotionEmbed(nn.Module):
    """Project each patch's motion channels to a token."""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.scales = config.motion_scales
        self.cells = config.patch // CELL_PX
        inputs = CHANNELS * config.motion_scales * self.cells**2
        self.project = nn.Sequential(
            nn.Linear(inputs, config.width), nn.GELU(), nn.Linear(config.width, config.width)
        )

    def forward(self, reference: list[torch.Tensor], current: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D) from the reference at every scale and current images.

        A batch of 1 serves any B.
        """
        levels = [level.expand(len(current), -1, -1, -1) for level in reference]
        maps = motion_channels(levels, current)  # (B, 3·scales, S / 4, S / 4)
        return self.project(patches(maps, self.cells))


class EncoderBlock(nn.Module):
    """Attention in space, causal attention in time, MLP."""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.spatial = SpatialAttention(config.width, config.heads)
        self.temporal = CausalPairAttention(config.width, config.heads)
        self.mlp = FeedForward(config.width, config.mlp_ratio)

    def reference(
        self, tokens: torch.Tensor
    ) -> tuple[torch.Tensor, tuple[torch.Tensor, torch.Tensor]]:
        """Return reference tokens (B, P, D) and the (key, value) to keep."""
        tokens, kept = self.temporal.reference(self.spatial(tokens))
        return self.mlp(tokens), kept

    def current(
        self, tokens: torch.Tensor, past: tuple[torch.Tensor, torch.Tensor]
    ) -> torch.Tensor:
        """Return current tokens (B, P, D)."""
        return self.mlp(self.temporal.current(self.spatial(tokens), past))


class Encoder(nn.Module):
    """Inverse dynamics: what force turned the reference into the current image?"""

    time: torch.Tensor

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.latent = config.latent
        self.embed = PatchEmbed(config, config.embed_hidden)
        self.motion = MotionEmbed(config) if config.motion_scales else None
        self.blocks = nn.ModuleList(EncoderBlock(config) for _ in range(config.depth))
        self.posterior = nn.Sequential(
            nn.LayerNorm(config.width), nn.Linear(config.width, 2 * config.latent)
        )
        with torch.no_grad():  # at σ = 1 noise would drown what little μ says at first
            self.posterior[1].bias[config.latent :] = START_LOG_VARIANCE
        self.register_buffer("time", sinusoid(torch.arange(2), config.width), persistent=False)

    def encode_reference(self, reference: torch.Tensor) -> ReferenceCache:
        """Return what the current frame needs of (B, 1, S, S) references.

        It depends on nothing else.
        """
        tokens = self.embed(reference) + self.time[0]
        halved = [] if self.motion is None else pyramid(reference, self.motion.scales)
        cache = ReferenceCache(reference, halved, [])
        for block in self.blocks:
            tokens, kept = block.reference(tokens)
            cache.kept.append(kept)
        return cache

    def encode_current(self, cache: ReferenceCache, current: torch.Tensor) -> Posterior:
        """Return the posterior for (B, 1, S, S) current images; a cache of batch 1 serves any B."""
        tokens = self.embed(current) + self.time[1]
        if self.motion is not None:
            tokens = tokens + self.motion(cache.halved, current)
        for block, past in zip(self.blocks, cache.kept, strict=True):
            tokens = block.current(tokens, past)
        # (B, P, latent) each
        mean, log_variance = self.posterior(tokens).split(self.latent, dim=-1)
        return Posterior(mean, log_variance.clamp(*LOG_VARIANCE_RANGE))

    def forward(self, reference: torch.Tensor, current: torch.Tensor) -> Posterior:
        """Encode both frames; equal to the cached path by construction."""
        return self.encode_current(self.encode_reference(reference), current)


class DecoderBlock(nn.Module):
    """Attention among patches, MLP."""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            SpatialAttention(config.width, config.heads),
            FeedForward(config.width, config.mlp_ratio),
        )

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D)."""
        return self.layers(tokens)


class Decoder(nn.Module):
    """Forward dynamics: what would a sensor with this reference show under this force?"""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.config = config
        self.embed = PatchEmbed(config)
        self.inject = nn.Linear(config.latent, config.width)
        self.blocks = nn.Sequential(*[DecoderBlock(config) for _ in range(config.decoder_depth)])
        self.draw = nn.Sequential(
            nn.LayerNorm(config.width), nn.Linear(config.width, config.patch**2)
        )
        nn.init.zeros_(self.draw[1].weight)  # starts from the reference itself (or from black)
        self.flow = FlowHead(config) if config.warp else None

    def forward(self, reference: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        """Return (B, 1, S, S) current images from references and latents (B, P, latent)."""
        tokens = self.blocks(self.embed(reference) + self.inject(z))
        drawn = self.draw(tokens)  # (B, P, patch²)
        size = (self.config.side, self.config.side)
        image = F.fold(drawn.transpose(1, 2), size, self.config.patch, stride=self.config.patch)
        if not self.config.predict_change:
            return image
        moved = reference if self.flow is None else warped(reference, self.flow(tokens))
        return moved + image


class FlowHead(nn.Module):
    """Tokens → where each pixel comes from: a flow on 4-pixel cells, smoothly enlarged."""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.side, self.cells, self.grid = config.side, config.patch // CELL_PX, config.grid
        self.project = nn.Sequential(
            nn.LayerNorm(config.width), nn.Linear(config.width, 2 * self.cells**2)
        )
        nn.init.zeros_(self.project[1].weight)  # starts without motion
        nn.init.zeros_(self.project[1].bias)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Return (B, 2, S, S).

        The shift in x and y, in pixels, from a pixel to its place in the reference.
        """
        cells = self.project(tokens).transpose(1, 2)  # (B, 2·cells², P)
        size = (self.grid * self.cells, self.grid * self.cells)
        coarse = F.fold(cells, size, self.cells, stride=self.cells)  # (B, 2, S/4, S/4)
        return FLOW_PX * F.interpolate(
            coarse, (self.side, self.side), mode="bilinear", align_corners=False
        )


def warped(image: torch.Tensor, flow_px: torch.Tensor) -> torch.Tensor:
    """Return (B, 1, S, S) ``image`` sampled at each pixel's place plus ``flow_px`` (B, 2, S, S)."""
    side = image.shape[-1]
    axis = torch.arange(side, device=image.device, dtype=image.dtype)
    place = torch.stack(torch.meshgrid(axis, axis, indexing="xy"))  # (2, S, S): x, y
    unit = (place + flow_px) * (2 / side) + (1 / side - 1)  # pixel centres in [-1, 1]
    return F.grid_sample(image, unit.permute(0, 2, 3, 1), padding_mode="zeros", align_corners=False)


class ForceAutoencoder(nn.Module):
    """Encoder and decoder together."""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config)
        self.decoder = Decoder(config)

    def forward(self, reference: torch.Tensor, current: torch.Tensor) -> Posterior:
        """Return the posterior over the latent force map."""
        return self.encoder(reference, current)


def build_model(config: TokenizerConfig, seed: int) -> ForceAutoencoder:
    """Return a model with weights drawn from ``seed``, leaving the global generator as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return ForceAutoencoder(config)
