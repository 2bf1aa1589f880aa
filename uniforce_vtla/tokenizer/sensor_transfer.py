"""What the other finger of a grasp would have said: maps between sensors' pooled latents, with their doubt.

One frozen tokenizer reads every sensor, but two fingers of one grasp don't say the same: sensors are read a little
differently, and the fingers share the grasp's force, not its torsion (contact/two_fingers.py). Grasps are simulated and
need no label, so how much fingers differ is known before any policy is trained. A policy that hears part of its demos
as another finger would have told them can't lean on what only its own finger says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from uniforce_vtla.contact.two_fingers import OtherFinger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.options import Count, NotNegative, Positive, Seed, Share, Sizes
from uniforce_vtla.tokenizer.agreed_directions import MOST, agreed_directions
from uniforce_vtla.tokenizer.weights import checkpoint_folder, load_model, read_config, save_checkpoint

FOLDER = "transfer"  # beside a shipped tokenizer's folder, inside one given by path
LOUDEST = 2.0  # doubt grows no further: no grasp that maps were fitted on is much louder
QUIETEST = 0.1  # loudness below which differences say nothing of doubt
MAX_KINDS, MAX_NUMBERS = 16, 1024  # larger files are none of ours


@dataclass(frozen=True)
class SensorTransferFit:
    """How the grasps are drawn and the maps fitted."""

    grasps: Count = 4096  # each felt by every sensor on either finger; about a minute per thousand
    flat_share: Share = 1.0  # all held tools: what a policy feels
    # a held tool that wipes twists flat pads so much (contact/sampling.py)
    flat_torsion_arm_mm: NotNegative = 9.0
    # a held tool covers the pad; 12–40 bent the reading of GelSight
    flat_side_mm: Sizes = (30.0, 70.0)
    # what parallel fingers hold lies flat on both pads but for their give (a wiped eraser leans by .01, a wedged one by
    # up to .046); a flat gel shows a leaning face as less grip: with .03 or .045 a finger that swaps to GelSight feels
    # 1.2 to 1.7 N too much grip, and no less by scene
    flat_tilt_rad: NotNegative = 0.015
    other: OtherFinger = field(default_factory=OtherFinger)  # what fingers of a grasp don't share
    grid: Count = 4  # latents pooled to grid × grid, as policies read them
    ridge: Positive = 30.0  # grasps' worth of belief that fingers say the same
    held_out: Share = 0.2  # share of the grasps that only judge, and give the doubt
    seed: Seed = 1  # of everything drawn


class SensorTransfer(nn.Module):
    """z of a source sensor → matrix · z + offset + loudness(z) · doubt · noise, for every source and target.

    Friction bounds torsion and side force by the press, so fingers differ the more the harder they press: doubt is of a
    grasp as loud as the average one, and nothing is in doubt where nothing is felt.

    Attributes:
        kinds: sensors' names; their places are the indices below.
        matrix, doubt: (S, S, n, n) by source and target, n = grid² · latent; ``doubt`` is lower-triangular.
        offset: (S, S, n).
        rest: (S, n) latents of a source in free air.
        unit: (S, n) what a number is divided by for loudness: its spread times the average grasp's loudness.
        directions: (n, MOST) on which all sensors agree, best first, of spread 1 over grasps (agreed_directions.py).
        origin: (MOST,) what free air shows along them.
        disagreement: (MOST,) spread of what fingers of one grasp say along them.
    """

    matrix: Tensor
    doubt: Tensor
    offset: Tensor
    rest: Tensor
    unit: Tensor
    directions: Tensor
    origin: Tensor
    disagreement: Tensor

    def __init__(self, kinds: Sequence[str], numbers: int, tokenizer_hash: str = "") -> None:
        super().__init__()
        if not 1 <= len(kinds) <= MAX_KINDS or not 1 <= numbers <= MAX_NUMBERS:
            came = f"{len(kinds)} sensors, {numbers} numbers"
            do = "Fit it again with python -m benchmarks.sensor_transfer."
            raise CheckpointError(expected("transfer", f"up to {MAX_KINDS}, {MAX_NUMBERS}", came, do))
        self.kinds, self.tokenizer_hash = tuple(kinds), tokenizer_hash
        square = (len(kinds), len(kinds), numbers, numbers)
        self.register_buffer("matrix", torch.zeros(square))
        self.register_buffer("doubt", torch.zeros(square))
        self.register_buffer("offset", torch.zeros(square[:3]))
        self.register_buffer("rest", torch.zeros(square[1:3]))
        self.register_buffer("unit", torch.ones(square[1:3]))
        most = min(MOST, numbers)
        self.register_buffer("directions", torch.zeros(numbers, most))
        self.register_buffer("origin", torch.zeros(most))
        self.register_buffer("disagreement", torch.ones(most))

    def row(self, source: str) -> int:
        """Return the index of a source sensor.

        Raises:
            ContractError: a sensor these maps don't know.
        """
        if source not in self.kinds:
            do = "Fit it with python -m benchmarks.sensor_transfer, or train with policy.augment.sensor_transfer=0."
            raise ContractError(expected("sensor of the demos", " | ".join(self.kinds), repr(source), do))
        return self.kinds.index(source)

    def told(self, z: Tensor, row: int, target: int, doubt: float = 1.0) -> Tensor:
        """Return what a finger with the sensor ``target`` would have said, drawn at random, of z (B, n).

        ``doubt`` is how much of it is drawn: 0 tells what is expected, 1 what may come.
        """
        loud = ((z - self.rest[row]) / self.unit[row]).square().mean(dim=1, keepdim=True).sqrt()  # (B, 1)
        noise = torch.randn_like(z) @ self.doubt[row, target].T
        return (
            z @ self.matrix[row, target].T
            + self.offset[row, target]
            + doubt * loud.clamp(max=LOUDEST) * noise
        )

    @classmethod
    def from_pretrained(cls, tokenizer: str | Path | None, tokenizer_hash: str) -> SensorTransfer:
        """Load the maps that belong to a tokenizer: shipped ("small", None or "nano"), or a folder's own.

        Raises:
            CheckpointError: none there, damaged, not of this form, or made for a tokenizer of another hash.
        """
        folder = checkpoint_folder(tokenizer, FOLDER)
        folder = folder if folder.name == FOLDER else folder / FOLDER
        facts = read_config(folder)
        try:
            kinds, numbers = [str(kind) for kind in facts["kinds"]], int(facts["numbers"])
            made_for = str(facts["tokenizer_hash"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            do = "Fit it again with python -m benchmarks.sensor_transfer."
            raise CheckpointError(expected(str(folder), "kinds, numbers, hash", error, do)) from error
        if made_for != tokenizer_hash:
            do = "Run python -m benchmarks.sensor_transfer for this tokenizer."
            raise CheckpointError(expected("tokenizer of the maps", tokenizer_hash, made_for, do))
        return load_model(folder, lambda: cls(kinds, numbers, tokenizer_hash))

    def save(self, folder: str | Path, facts: Mapping[str, Any]) -> Path:
        """Write maps and what they were fitted on to a folder that ``from_pretrained`` finds."""
        own = {"kinds": self.kinds, "numbers": self.offset.shape[-1], "tokenizer_hash": self.tokenizer_hash}
        return save_checkpoint(Path(folder), self, {**facts, **own})


@dataclass(frozen=True)
class GraspLatents:
    """What a sensor says of N grasps: ``first``, ``second`` finger (N, K, L) pooled, ``rest`` (K, L) in free air."""

    first: np.ndarray
    second: np.ndarray
    rest: np.ndarray


def fit_transfer(
    latents: Mapping[str, GraspLatents], tokenizer_hash: str, config: SensorTransferFit
) -> tuple[SensorTransfer, dict[str, Any]]:
    """Return the maps and how well they tell, on grasps held out.

    Args:
        latents: sensor → what it says of the same grasps on either finger.
        tokenizer_hash: whose latents they are.
        config: how they were drawn; ridge and share held out.
    """
    kinds = list(latents)
    count, rows, size = latents[kinds[0]].first.shape
    transfer = SensorTransfer(kinds, rows * size, tokenizer_hash)
    cells = {}
    for i, source in enumerate(kinds):
        before, spread = latents[source].first.reshape(count, -1), _spread(latents[source].first)
        rest = latents[source].rest.reshape(-1)
        loud = np.sqrt(np.square((before - rest) / spread).mean(axis=1))
        transfer.rest[i], transfer.unit[i] = _tensor(rest), _tensor(spread * loud.mean())
        for j, target in enumerate(kinds):
            after = latents[target].second.reshape(count, -1)
            fitted = _fit(before, after, spread, loud / loud.mean(), config)
            cells[f"{source}->{target}"] = fitted.facts
            transfer.matrix[i, j] = _tensor(fitted.matrix)
            transfer.offset[i, j] = _tensor(fitted.offset)
            transfer.doubt[i, j] = _tensor(fitted.doubt)
    agreed = agreed_directions(
        [finger.reshape(count, -1) for told in latents.values() for finger in (told.first, told.second)],
        [told.rest.reshape(-1) for told in latents.values()],
    )
    transfer.directions.copy_(_tensor(agreed.matrix))
    transfer.origin.copy_(_tensor(agreed.origin))
    transfer.disagreement.copy_(_tensor(agreed.disagreement))
    ratios = [round(float(ratio), 1) for ratio in agreed.ratios]
    return transfer, {"config": asdict(config), "differences": cells, "agreement": ratios}


@dataclass(frozen=True)
class _Fitted:
    matrix: np.ndarray
    offset: np.ndarray
    doubt: np.ndarray
    facts: dict[str, float]


def _fit(
    before: np.ndarray, after: np.ndarray, spread: np.ndarray, loud: np.ndarray, config: SensorTransferFit
) -> _Fitted:
    """Fit after − before = M' before + b by ridge in units of the source's spread; doubt from what is held out."""
    mean = before.mean(axis=0, dtype=np.float64)
    x, change = (before - mean) / spread, (after - before) / spread
    learnt = int(len(x) * (1 - config.held_out))
    told = np.c_[x, np.ones(len(x))]
    pull = np.diag([config.ridge] * x.shape[1] + [0.0])
    weights = np.linalg.solve(told[:learnt].T @ told[:learnt] + pull, told[:learnt].T @ change[:learnt])
    left, heard = (change - told @ weights)[learnt:], loud[learnt:]
    evened = (left / heard[:, None])[heard > QUIETEST]  # as if every grasp were as loud as the average one
    doubt = np.linalg.cholesky(evened.T @ evened / len(evened) + 1e-6 * np.eye(x.shape[1]))
    matrix = np.eye(x.shape[1]) + spread[:, None] * weights[:-1].T / spread[None]
    offset = mean + spread * weights[-1] - matrix @ mean
    facts = {"rms": _rms(change[learnt:]), "rms_left": _rms(left)}  # in spreads of the source
    return _Fitted(matrix, offset, spread[:, None] * doubt, facts)


def _spread(latents: np.ndarray) -> np.ndarray:
    """Return (n,) spread of each number over grasps, alike for all cells of a channel, as force tokens see it."""
    channels = np.sqrt((latents.astype(np.float64).std(axis=0) ** 2).mean(axis=0))  # (L,)
    return np.tile(np.maximum(channels, 1e-3), latents.shape[1])


def _rms(values: np.ndarray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 3)


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(values)).float()
