"""Twins of other objectives: our encoder's size, our pictures, no force label, no equilibrium.

``mae`` hides three quarters of the patches and asks for them back (as AnyTouch and T3 pretrain); ``vqvae`` squeezes
every patch through a small codebook (as UniT does). What a row of theirs lacks against ours is the objective.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.baselines.cells import check_seeds
from benchmarks.baselines.pictures import pictures
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import POOL, Cells, Table, learnt_row
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.attention import FeedForward, SpatialAttention, grid_code
from uniforce_vtla.tokenizer.latent import pool_latent
from uniforce_vtla.tokenizer.losses import gradient_pyramid
from uniforce_vtla.tokenizer.model import MotionEmbed, PatchEmbed, TokenizerConfig
from uniforce_vtla.tokenizer.motion import pyramid
from uniforce_vtla.tokenizer.pair_cache import PairSource

Kind = Literal["mae", "vqvae"]


@dataclass(frozen=True)
class TwinConfig:
    """Sizes and training; the training numbers are those of our own pretraining."""

    model: TokenizerConfig = field(default_factory=TokenizerConfig)  # width, depth, heads, patch, embeddings
    hidden_share: float = 0.75  # of patches hidden from the masked autoencoder
    codes: int = 1024  # entries of the codebook, as in UniT
    code_size: int = 3  # numbers per entry, as in UniT
    commitment: float = 0.25  # weight of the codebook's pull on the encoder, as in UniT
    perceptual_weight: float = 0.1  # of the gradient pyramid in the VQ-VAE, which stands in for LPIPS
    pyramid_levels: int = 3  # scales of the gradient pyramid
    units_per_batch: int = 4  # units (references) in a batch
    pairs_per_unit: int = 8  # contacts of each
    learning_rate: float = 1e-3  # peak, AdamW
    weight_decay: float = 0.01  # AdamW
    warmup_steps: int = 100  # linear to the peak, then cosine to a fiftieth
    clip_norm: float = 1.0  # of the gradient
    device: str = "cpu"  # where it trains; the encoder comes back on the CPU


class PairTokens(nn.Module):
    """Patch embeddings of reference and current image, added; motion channels as in our encoder."""

    def __init__(self, config: TokenizerConfig) -> None:
        super().__init__()
        self.reference = PatchEmbed(config, config.embed_hidden)
        self.current = PatchEmbed(config, config.embed_hidden)
        self.motion = MotionEmbed(config) if config.motion_scales else None

    def forward(self, reference: torch.Tensor, current: torch.Tensor) -> torch.Tensor:
        """Return (B, P, D) for images (B, 1, S, S)."""
        tokens = self.reference(reference) + self.current(current)
        if self.motion is None:
            return tokens
        return tokens + self.motion(pyramid(reference, self.motion.scales), current)


class TwinEncoder(nn.Module):
    """What a twin keeps after training: pictures in, (B, P, L) out."""

    def __init__(self, config: TwinConfig) -> None:
        super().__init__()
        self.config = config
        self.embed = PairTokens(config.model)
        self.blocks = _blocks(config.model, config.model.depth)
        self.out: nn.Module = nn.LayerNorm(config.model.width)

    def forward(self, reference: torch.Tensor, current: torch.Tensor) -> torch.Tensor:
        """Return latents (B, P, L) for images (B, 1, S, S)."""
        return self.out(self.blocks(self.embed(reference, current)))

    @torch.no_grad()
    def features(self, labelled: LabelledSet) -> torch.Tensor:
        """Return pooled latents (n, T, POOL², L) of a labelled set.

        Raises:
            ContractError: images of another size than the model's.
        """
        shown, side = pictures(labelled), self.config.model.side
        if shown.reference.shape[-1] != side:
            raise ContractError(expected("pictures", f"side {side}", shown.reference.shape, "Draw them so."))
        rows = []
        for index in range(len(shown.frames)):
            reference, frames = shown.tensors(slice(index, index + 1))
            current = frames[0][:, None]  # (T, 1, S, S)
            rows.append(pool_latent(self(reference.expand_as(current), current), POOL))
        return torch.stack(rows)


class MaskedAutoencoder(nn.Module):
    """Encoder of the visible patches, decoder of both images' hidden ones."""

    def __init__(self, config: TwinConfig) -> None:
        super().__init__()
        self.config, model = config, config.model
        self.encoder = TwinEncoder(config)
        self.mask = nn.Parameter(torch.zeros(model.width))
        self.decoder = _blocks(model, model.decoder_depth)
        self.draw = nn.Sequential(nn.LayerNorm(model.width), nn.Linear(model.width, 2 * model.patch**2))
        self.register_buffer("position", grid_code(model.grid, model.width), persistent=False)

    def loss(self, reference: torch.Tensor, current: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error over hidden patches."""
        tokens = self.encoder.embed(reference, current)  # (B, P, D)
        order = torch.rand(tokens.shape[:2], device=tokens.device).argsort(dim=1)
        visible = order[:, : max(1, round(tokens.shape[1] * (1 - self.config.hidden_share)))]
        index = visible[..., None].expand(-1, -1, tokens.shape[2])  # (B, V, D)
        seen = self.encoder.out(self.encoder.blocks(tokens.gather(1, index)))
        full = self.mask.expand_as(tokens).scatter(1, index, seen) + self.position
        drawn = self.draw(self.decoder(full))  # (B, P, 2·patch²)
        error = (drawn - _patches(reference, current, self.config.model.patch)).square().mean(dim=2)
        hidden = torch.ones_like(error).scatter(1, visible, 0.0)  # (B, P)
        return (error * hidden).sum() / hidden.sum()


class VQVAE(nn.Module):
    """Encoder, nearest code per patch, decoder of both images."""

    def __init__(self, config: TwinConfig) -> None:
        super().__init__()
        self.config, model = config, config.model
        self.encoder = TwinEncoder(config)
        self.encoder.out = nn.Sequential(nn.LayerNorm(model.width), nn.Linear(model.width, config.code_size))
        self.codes = nn.Embedding(config.codes, config.code_size)
        self.lift = nn.Linear(config.code_size, model.width)
        self.decoder = _blocks(model, model.decoder_depth)
        self.draw = nn.Sequential(nn.LayerNorm(model.width), nn.Linear(model.width, 2 * model.patch**2))
        self.register_buffer("position", grid_code(model.grid, model.width), persistent=False)

    @torch.no_grad()
    def start_codes(self, reference: torch.Tensor, current: torch.Tensor) -> None:
        """Spread the codebook over the latents of a batch: codes far from all latents would never be used."""
        z = self.encoder(reference, current).flatten(0, 1)  # (B·P, code_size)
        rows = torch.randint(len(z), (self.config.codes,), device=z.device)
        near = 0.01 * z.std(dim=0) * torch.randn_like(z[rows])  # a latent drawn twice gives two codes
        self.codes.weight.copy_(z[rows] + near)

    def quantise(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the nearest codes (B, P, code_size) and the loss that pulls codes and latents together."""
        # By differences: the matrix product that cdist prefers is off by more than close codes are apart.
        exact = "donot_use_mm_for_euclid_dist"
        apart = torch.cdist(z.flatten(0, 1), self.codes.weight, compute_mode=exact)  # (B·P, codes)
        near = self.codes(apart.argmin(dim=1)).view_as(z)
        pull = F.mse_loss(near, z.detach()) + self.config.commitment * F.mse_loss(z, near.detach())
        return z + (near - z).detach(), pull

    def loss(self, reference: torch.Tensor, current: torch.Tensor) -> torch.Tensor:
        """Return L1, gradient pyramid and the codebook's pull."""
        model = self.config.model
        codes, pull = self.quantise(self.encoder(reference, current))
        drawn = self.draw(self.decoder(self.lift(codes) + self.position)).transpose(1, 2)  # (B, 2·patch², P)
        images = F.fold(drawn, (model.side, model.side), model.patch, stride=model.patch)  # (B, 2, S, S)
        truth = torch.cat([reference, current], dim=1)
        edges = gradient_pyramid(images, truth, self.config.pyramid_levels)
        return (images - truth).abs().mean() + self.config.perceptual_weight * edges + pull


def train_twin(
    kind: Kind, cache: PairSource, steps: int, seed: int, config: TwinConfig | None = None
) -> TwinEncoder:
    """Return an encoder trained for ``steps`` on pictures of the cache, either finger's on its own."""
    return train_twin_with_losses(kind, cache, steps, seed, config)[0]


def train_twin_with_losses(
    kind: Kind, cache: PairSource, steps: int, seed: int, config: TwinConfig | None = None
) -> tuple[TwinEncoder, list[float]]:
    """Return the encoder and the loss of every step.

    Raises:
        ContractError: no such kind, no step.
    """
    config = config or TwinConfig()
    if kind not in get_args(Kind) or steps < 1:
        wanted = f"{' | '.join(get_args(Kind))}, at least 1 step"
        raise ContractError(expected("twin", wanted, f"{kind!r}, {steps} steps", "Choose one."))
    rng = np.random.default_rng([seed, 0])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = (MaskedAutoencoder(config) if kind == "mae" else VQVAE(config)).to(config.device)
        optimizer = torch.optim.AdamW(
            model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _rate(step, steps, config))
        losses = []
        for step in range(steps):
            reference, current = (images.to(config.device) for images in _batch(cache, rng, config))
            if step == 0 and isinstance(model, VQVAE):
                model.start_codes(reference, current)
            loss = model.loss(reference, current)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(model.parameters(), config.clip_norm)
            optimizer.step()
            schedule.step()
            losses.append(loss.item())
    return model.encoder.cpu().eval().requires_grad_(False), losses


def twin_row(table: Table, twin: TwinEncoder, seeds: int) -> Cells:
    """Return a twin's row: frozen, same pooling, same head as ours."""
    check_seeds(seeds)
    return learnt_row(table, twin.features, seeds, POOL)


def _batch(
    cache: PairSource, rng: np.random.Generator, config: TwinConfig
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return references and currents (2·U·n, 1, S, S): both fingers, without saying who belongs to whom."""
    pairs = cache.draw(rng, config.units_per_batch, config.pairs_per_unit)
    reference = torch.cat([pairs.left_reference, pairs.right_reference])
    current = torch.cat([pairs.left_current, pairs.right_current])
    return reference.repeat_interleave(len(current) // len(reference), dim=0), current


def _rate(step: int, steps: int, config: TwinConfig) -> float:
    """Return the learning rate over its peak."""
    warmup = min(config.warmup_steps, steps // 4)  # short runs must get past it
    if step < warmup:
        return (step + 1) / warmup
    done = (step - warmup) / max(1, steps - warmup)
    return 0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


def _patches(reference: torch.Tensor, current: torch.Tensor, patch: int) -> torch.Tensor:
    """Return both images' pixels by patch, (B, P, 2·patch²)."""
    return F.unfold(torch.cat([reference, current], dim=1), patch, stride=patch).transpose(1, 2)


def _blocks(model: TokenizerConfig, depth: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for _ in range(depth):
        layers += [SpatialAttention(model.width, model.heads), FeedForward(model.width, model.mlp_ratio)]
    return nn.Sequential(*layers)
