"""What another sensor would have said of the same touch: maps between sensors' pooled latents, with their doubt.

One frozen tokenizer reads every sensor, but not alike in every number: two sensors in one grasp differ by a third of
what touch moves in a latent. Grasps are simulated and need no label, so how sensors differ is known before any policy
is trained. A policy that hears part of its demos as another sensor would have told them can't lean on what only its
own sensor says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.weights import checkpoint_folder, load_model, read_config, save_checkpoint

FOLDER = "transfer"  # beside a shipped tokenizer's folder, inside one given by path
MAX_KINDS, MAX_NUMBERS = 16, 1024  # larger files are none of ours


@dataclass(frozen=True)
class TransferConfig:
    """How the touches are drawn and the maps fitted."""

    contacts: int = 4096  # each felt by two units of every sensor; about a minute per thousand
    flat_share: float = 1.0  # all held tools: what a policy feels
    flat_torsion_arm_mm: float = (
        9.0  # a held tool that wipes twists flat pads by so much (contact/sampling.py)
    )
    grid: int = 4  # latents pooled to grid × grid, as policies read them
    ridge: float = 30.0  # touches' worth of belief that sensors say the same
    held_out: float = 0.2  # share of the touches that only judge, and give the doubt
    seed: int = 1  # of everything drawn


class SensorTransfer(nn.Module):
    """z of a source sensor → matrix · z + offset + doubt · noise, for every source and target.

    Attributes:
        kinds: sensors' names; their places are the indices below.
        matrix, doubt: (S, S, n, n) by source and target, n = grid² · latent; ``doubt`` is lower-triangular.
        offset: (S, S, n).
    """

    matrix: Tensor
    doubt: Tensor
    offset: Tensor

    def __init__(self, kinds: Sequence[str], numbers: int, tokenizer_hash: str = "") -> None:
        super().__init__()
        if not 1 <= len(kinds) <= MAX_KINDS or not 1 <= numbers <= MAX_NUMBERS:
            came = f"{len(kinds)} sensors, {numbers} numbers"
            do = "Fit it again with uniforce-sensor-transfer."
            raise CheckpointError(expected("transfer", f"up to {MAX_KINDS}, {MAX_NUMBERS}", came, do))
        self.kinds, self.tokenizer_hash = tuple(kinds), tokenizer_hash
        square = (len(kinds), len(kinds), numbers, numbers)
        self.register_buffer("matrix", torch.zeros(square))
        self.register_buffer("doubt", torch.zeros(square))
        self.register_buffer("offset", torch.zeros(square[:3]))

    def of(self, source: str) -> tuple[Tensor, Tensor, Tensor]:
        """Return matrices (S, n, n), offsets (S, n) and doubts (S, n, n) from ``source`` to every sensor.

        Raises:
            ContractError: a sensor these maps don't know.
        """
        if source not in self.kinds:
            do = "Fit it with uniforce-sensor-transfer, or train with policy.sensor_transfer=0."
            raise ContractError(expected("sensor of the demos", " | ".join(self.kinds), repr(source), do))
        row = self.kinds.index(source)
        return self.matrix[row], self.offset[row], self.doubt[row]

    @classmethod
    def from_pretrained(cls, tokenizer: str | Path | None = None) -> SensorTransfer:
        """Load the maps that belong to a tokenizer: shipped ("small", None or "nano"), or a folder's own.

        Raises:
            CheckpointError: none there, truncated, or not of this form.
        """
        folder = checkpoint_folder(tokenizer, FOLDER)
        folder = folder if folder.name == FOLDER else folder / FOLDER
        facts = read_config(folder)
        try:
            kinds, numbers = [str(kind) for kind in facts["kinds"]], int(facts["numbers"])
            tokenizer_hash = str(facts["tokenizer_hash"])
        except (KeyError, TypeError, ValueError) as error:
            do = "Fit it again with uniforce-sensor-transfer."
            raise CheckpointError(expected(str(folder), "kinds, numbers, hash", error, do)) from error
        return load_model(folder, lambda: cls(kinds, numbers, tokenizer_hash))

    def save(self, folder: str | Path, facts: Mapping[str, Any]) -> Path:
        """Write maps and what they were fitted on to a folder that ``from_pretrained`` finds."""
        own = {"kinds": self.kinds, "numbers": self.offset.shape[-1], "tokenizer_hash": self.tokenizer_hash}
        return save_checkpoint(Path(folder), self, {**facts, **own})


def fit_transfer(
    latents: Mapping[str, tuple[np.ndarray, np.ndarray]], tokenizer_hash: str, config: TransferConfig
) -> tuple[SensorTransfer, dict[str, Any]]:
    """Return the maps and how well they tell, on touches held out.

    Args:
        latents: sensor → pooled latents (N, K, L) of the same N touches, of two of its units.
        tokenizer_hash: whose latents they are.
        config: how they were drawn; ridge and share held out.
    """
    kinds = list(latents)
    count, rows, size = latents[kinds[0]][0].shape
    transfer = SensorTransfer(kinds, rows * size, tokenizer_hash)
    cells = {}
    for i, source in enumerate(kinds):
        for j, target in enumerate(kinds):
            before = latents[source][0].reshape(count, -1)
            after = latents[target][1].reshape(count, -1)
            fitted = _fit(before, after, _spread(latents[source][0]), config)
            cells[f"{source}->{target}"] = fitted.facts
            transfer.matrix[i, j] = torch.from_numpy(fitted.matrix).float()
            transfer.offset[i, j] = torch.from_numpy(fitted.offset).float()
            transfer.doubt[i, j] = torch.from_numpy(fitted.doubt).float()
    return transfer, {"config": asdict(config), "differences": cells}


@dataclass(frozen=True)
class _Fitted:
    matrix: np.ndarray
    offset: np.ndarray
    doubt: np.ndarray
    facts: dict[str, float]


def _fit(before: np.ndarray, after: np.ndarray, spread: np.ndarray, config: TransferConfig) -> _Fitted:
    """Fit after − before = M' before + b by ridge in units of the source's spread; doubt from what is held out."""
    mean = before.mean(axis=0, dtype=np.float64)
    x, change = (before - mean) / spread, (after - before) / spread
    learnt = int(len(x) * (1 - config.held_out))
    told = np.c_[x, np.ones(len(x))]
    pull = np.diag([config.ridge] * x.shape[1] + [0.0])
    weights = np.linalg.solve(told[:learnt].T @ told[:learnt] + pull, told[:learnt].T @ change[:learnt])
    left = (change - told @ weights)[learnt:]
    doubt = np.linalg.cholesky(left.T @ left / len(left) + 1e-6 * np.eye(x.shape[1]))
    matrix = np.eye(x.shape[1]) + spread[:, None] * weights[:-1].T / spread[None]
    offset = mean + spread * weights[-1] - matrix @ mean
    facts = {"rms": _rms(change[learnt:]), "rms_left": _rms(left)}  # in spreads of the source
    return _Fitted(matrix, offset, spread[:, None] * doubt, facts)


def _spread(latents: np.ndarray) -> np.ndarray:
    """Return (n,) spread of each number over touches, alike for all cells of a channel, as force tokens see it."""
    channels = np.sqrt((latents.astype(np.float64).std(axis=0) ** 2).mean(axis=0))  # (L,)
    return np.tile(np.maximum(channels, 1e-3), latents.shape[1])


def _rms(values: np.ndarray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 3)
