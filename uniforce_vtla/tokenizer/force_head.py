"""Force head: latent force maps → (fx, fy, fz) in newtons, canonical frame.

Trained on one source sensor only.

ConvGRU + MLP over latent sequences (facts: the form the paper probes frozen encoders with).
Training sees no other sensor's label.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.latent import own_latent, pool_latent
from uniforce_vtla.tokenizer.weights import (
    checkpoint_folder,
    content_hash,
    load_model,
    read_config,
    save_checkpoint,
)

SOURCE = "tactip"  # whose head is meant where none is named
# of HeadConfig, see model.LIMITS
LIMITS = {"channels": 4096, "grid": 64, "hidden": 4096, "mlp": 16384}


@dataclass(frozen=True)
class HeadConfig:
    """Sizes of a head; all of them travel with its checkpoint."""

    channels: int = 6  # numbers per patch of the latent
    grid: int = 4  # the map is pooled to grid × grid regions first; 1 for a plain vector
    hidden: int = 24  # channels of the ConvGRU
    mlp: int = 64  # hidden units of the MLP
    dropout: float = 0.1  # of the MLP's input, against clinging to one sensor's details

    def __post_init__(self) -> None:
        for name, most in LIMITS.items():
            check_count(f"force head's {name}", getattr(self, name), most)
        if not 0 <= self.dropout < 1:
            raise ContractError(
                expected("force head's dropout", "from 0 to 1", self.dropout, "Change it.")
            )


class ConvGRUCell(nn.Module):
    """A GRU whose gates are 3×3 convolutions."""

    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.hidden = hidden
        self.gates = nn.Conv2d(channels + hidden, 2 * hidden, 3, padding=1)
        self.proposal = nn.Conv2d(channels + hidden, hidden, 3, padding=1)

    def forward(self, inputs: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """Return the next (B, hidden, g, g) state."""
        update, reset = self.gates(torch.cat([inputs, state], 1)).sigmoid().chunk(2, dim=1)
        proposal = self.proposal(torch.cat([inputs, reset * state], 1)).tanh()
        return state + update * (proposal - state)


class ForceRegressor(nn.Module):
    """Standardised latent map → ConvGRU → MLP, plus a linear path from the map itself."""

    input_mean: torch.Tensor
    input_std: torch.Tensor
    force_scale: torch.Tensor

    def __init__(self, config: HeadConfig) -> None:
        super().__init__()
        self.config = config
        cells = config.grid**2
        self.register_buffer("input_mean", torch.zeros(config.channels, config.grid, config.grid))
        self.register_buffer("input_std", torch.ones(config.channels, config.grid, config.grid))
        self.register_buffer("force_scale", torch.ones(3))  # N
        self.cell = ConvGRUCell(config.channels, config.hidden)
        self.drop = nn.Dropout(config.dropout)
        self.linear = nn.Linear(config.channels * cells, 3)
        self.mlp = nn.Sequential(
            nn.Linear(config.hidden * cells, config.mlp), nn.GELU(), nn.Linear(config.mlp, 3)
        )

    def maps(self, z: torch.Tensor) -> torch.Tensor:
        """Return standardised (B, L, g, g) maps of latents (B, P, L)."""
        pooled = pool_latent(z, self.config.grid)  # (B, g², L)
        maps = pooled.transpose(1, 2).unflatten(2, (self.config.grid, self.config.grid))
        return (maps - self.input_mean) / self.input_std

    def step(
        self, z: torch.Tensor, state: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return force (B, 3) N and the next state for one frame of latents (B, P, L)."""
        maps = self.maps(z)
        if state is None:
            state = maps.new_zeros(len(maps), self.config.hidden, *maps.shape[2:])
        state = self.cell(maps, state)
        force = self.linear(self.drop(maps.flatten(1))) + self.mlp(self.drop(state.flatten(1)))
        return force * self.force_scale, state

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """Return (B, T, 3) N for latent sequences (B, T, P, L)."""
        state = None
        forces = []
        for frame in z.unbind(1):
            force, state = self.step(frame, state)
            forces.append(force)
        return torch.stack(forces, dim=1)


class ForceHead:
    """A trained head, in eval mode.

    It reads latents of its own tokenizer, as ``Tokenizer.encode`` returns them.

    Every call raises ContractError for a tensor without origin or of another shape, CheckpointError
    for latents of another tokenizer. ``model`` reads plain tensors, unchecked.

    Attributes:
        source: the only sensor whose forces it was trained on.
        tokenizer_hash: the tokenizer whose latents it reads.
        model: the network.
    """

    def __init__(self, model: ForceRegressor, source: str, tokenizer_hash: str) -> None:
        self.model = model.eval().requires_grad_(False)
        self.source = source
        self.tokenizer_hash = tokenizer_hash

    @classmethod
    def from_pretrained(
        cls, source: str | None = None, path: str | Path | None = None
    ) -> ForceHead:
        """Load the shipped head of ``source``, a head's folder, or the head beside a tokenizer.

        A head reads the latents of one tokenizer alone: pass ``"nano"`` for the smaller shipped
        one's. Without a ``source`` a head's own folder is taken as it is, and elsewhere the
        TacTip's.

        Raises CheckpointError: no head for that source, one of another source, or a checkpoint that
        doesn't fit.
        """
        part = f"force_head_{source or SOURCE}"
        folder = checkpoint_folder(path, part)
        facts = read_config(folder)
        if "head" not in facts:  # a tokenizer's: `uniforce pretrain` puts its heads beside it
            beside = folder.parent / part
            if not beside.is_dir():
                do = "Name a force head's folder, or a tokenizer's."
                raise CheckpointError(
                    expected(str(folder), f"a force head, or {part} beside it", "neither", do)
                )
            folder = beside
            facts = read_config(beside)
        try:
            config = HeadConfig(**facts["head"])
            found = str(facts["source"])
            tokenizer_hash = str(facts["tokenizer_hash"])
        except (KeyError, TypeError, ContractError) as error:
            wanted = "head, source, tokenizer_hash"
            raise CheckpointError(
                expected(f"config of {folder}", wanted, error, "Is this a force head?")
            ) from error
        if source not in (None, found):
            do = f"Name that sensor, or another folder than {folder}."
            raise CheckpointError(expected("force head's source", source, found, do))
        return cls(load_model(folder, lambda: ForceRegressor(config)), found, tokenizer_hash)

    @property
    def hash(self) -> str:
        """Content hash of weights and source.

        What is fitted or trained with a head's newtons stores it.
        """
        return content_hash(self.model, {"source": self.source})

    def save(self, path: str | Path) -> Path:
        """Write weights and facts to a folder that ``from_pretrained`` reads."""
        facts = {"source": self.source, "tokenizer_hash": self.tokenizer_hash}
        return save_checkpoint(Path(path), self.model, facts | {"head": asdict(self.model.config)})

    def __call__(self, z: torch.Tensor) -> torch.Tensor:
        """Return (B, 3) N for (B, P, L) latents, each a frame of its own without history."""
        return self.step(z, None)[0]

    @torch.no_grad()
    def sequence(self, z: torch.Tensor) -> torch.Tensor:
        """Return (B, T, 3) N for (B, T, P, L) latents, each frame with those before it."""
        own = self._own(z)
        if own.ndim != 4 or not own.shape[1]:
            raise ContractError(
                expected("latents", "(B, T, P, L)", tuple(z.shape), "Stack frames in time.")
            )
        self._frames(own.flatten(0, 1))
        return self.model(own)

    @torch.no_grad()
    def step(
        self, z: torch.Tensor, state: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return force (B, 3) N and the next state for one frame of (B, P, L) latents."""
        return self.model.step(self._frames(self._own(z)), state)

    def _own(self, z: torch.Tensor) -> torch.Tensor:
        return own_latent(z, self.tokenizer_hash, f"the force head of {self.source}")

    def _frames(self, z: torch.Tensor) -> torch.Tensor:
        """Return ``z`` if it is (B, P, channels) and finite; raise ContractError otherwise."""
        channels = self.model.config.channels
        square = z.ndim == 3 and math.isqrt(z.shape[1]) ** 2 == z.shape[1]
        if not square or z.shape[2] != channels or not len(z) or z.dtype != torch.float32:
            came = f"{z.dtype} {tuple(z.shape)}"
            do = "Use the tokenizer it was trained on."
            raise ContractError(expected("latents", f"float32 (B, P, {channels})", came, do))
        if not bool(z.isfinite().all()):
            raise ContractError(
                expected("latents", "finite numbers", "NaN or inf", "Check the images.")
            )
        return z


STD_FLOOR = 0.3  # of the channel's own spread: a cell that hardly moves must not be blown up


@dataclass(frozen=True)
class HeadTrainingConfig:
    """How a head is trained."""

    head: HeadConfig = field(default_factory=HeadConfig)
    steps: int = 400  # optimiser steps
    batch: int = 64  # sequences per step
    learning_rate: float = 3e-3  # AdamW, cosine to zero
    weight_decay: float = 0.05  # AdamW; keeps to what many cells agree on
    # of an input; a channel constant on the source would else explode elsewhere
    smallest_spread: float = 1e-6
    # of the standardised input: a source's fine print doesn't transfer. .8 was chosen among .1 …
    # 1.2 on the other sensors' *training* sequences, never on a frozen set
    input_noise: float = 0.8


def train_head(
    z: torch.Tensor, force_N: np.ndarray, config: HeadTrainingConfig, seed: int
) -> ForceRegressor:
    """Return a head fitted to latent sequences (n, T, P, L) and their forces (n, T, 3).

    Every step takes a random stretch of random length, single frames included, so that the head
    works with any history and with none.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        head = ForceRegressor(config.head)
        target = torch.from_numpy(force_N).float()
        _standardise(head, z, target, config.smallest_spread)
        rates = {"lr": config.learning_rate, "weight_decay": config.weight_decay}
        optimizer = torch.optim.AdamW(head.parameters(), **rates)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.steps)
        rng = np.random.default_rng(seed)
        spread = head.input_std.flatten(1).mean(1)  # (L,) one amount of noise per channel
        head.train()
        for _ in range(config.steps):
            frames = int(rng.integers(1, z.shape[1] + 1))
            start = int(rng.integers(0, z.shape[1] - frames + 1))
            rows = rng.integers(len(z), size=config.batch)
            given = z[rows, start : start + frames]  # (batch, frames, P, L)
            wanted = target[rows, start : start + frames] / head.force_scale
            noisy = given + config.input_noise * spread * torch.randn_like(given)
            loss = F.smooth_l1_loss(head(noisy) / head.force_scale, wanted, beta=0.2)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return head.eval()


def _standardise(
    head: ForceRegressor, z: torch.Tensor, force_N: torch.Tensor, smallest: float
) -> None:
    """Store the source's mean and spread per cell, and its force scale, inside the head."""
    maps = head.maps(z.flatten(0, 1))  # (n·T, L, g, g)
    std = maps.std(dim=0)
    channel = std.square().mean(dim=(1, 2), keepdim=True).sqrt()
    head.input_mean.copy_(maps.mean(dim=0))
    head.input_std.copy_(torch.maximum(std, STD_FLOOR * channel).clamp_min(smallest))
    head.force_scale.copy_(force_N.flatten(0, 1).std(dim=0))
