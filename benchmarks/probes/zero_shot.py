"""Zero-shot force on frozen sets: a head learns from one sensor and reads another."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from benchmarks.probes.labelled_set import LabelledSet, set_hash, within
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.force_head import (
    ForceHead,
    ForceRegressor,
    HeadTrainingConfig,
    train_head,
)
from uniforce_vtla.tokenizer.latent import POOL, pool_latent

# as in the paper's table
LETTER = {"gelsight": "G", "gelsight_d": "G", "tactip": "T", "uskin": "U"}

Features = dict[str, torch.Tensor]  # sensor → (n, T, P, L)
Cells = dict[str, dict[str, list[float]]]  # "G->T" → {"r2": [fx, fy, fz], "mae_N": …}


def transfer_name(source: str, target: str) -> str:
    """Return a transfer's name in the table, e.g. ``G->T``."""
    return f"{LETTER.get(source, source)}->{LETTER.get(target, target)}"


@dataclass(frozen=True)
class Table:
    """Labelled sets by sensor: ``training`` of seen indenters, ``frozen`` of unseen ones."""

    training: dict[str, LabelledSet]
    frozen: dict[str, LabelledSet]
    head: HeadTrainingConfig = field(default_factory=HeadTrainingConfig)

    def transfers(self) -> list[tuple[str, str]]:
        return [
            (source, target)
            for source in self.training
            for target in self.frozen
            if source != target
        ]


def check_frozen(facts: dict[str, Any], frozen: dict[str, LabelledSet]) -> None:
    """Raise DatasetError unless the set just drawn is the one that was committed."""
    wanted, came = facts["set_hash"], set_hash(frozen)
    if came != wanted:
        raise DatasetError(
            expected(
                "frozen zero-shot set", wanted, came, "The contact model changed: freeze anew."
            )
        )


@torch.no_grad()
def encode_set(tokenizer: Tokenizer, labelled: LabelledSet) -> torch.Tensor:
    """Return pooled latents (n, T, POOL², L) of a labelled set (worn on the left finger)."""
    rows = [
        pool_latent(tokenizer.encode(before, after), POOL)
        for before, after in zip(labelled.reference, labelled.frames, strict=True)
    ]
    return torch.stack(rows)


def descriptor_features(labelled: LabelledSet) -> torch.Tensor:
    """Return the hand descriptor in natural units as a map of one region, (n, T, 1, 6)."""
    return torch.from_numpy(labelled.descriptor / np.asarray(NATURAL_UNITS, np.float32))[:, :, None]


def descriptor_row(table: Table, seeds: int) -> Cells:
    """Return the hand descriptor's row: the same head; spread below a natural unit is no signal."""
    head = replace(table.head, smallest_spread=1.0)
    return learnt_row(replace(table, head=head), descriptor_features, seeds, grid=1)


def learnt_row(
    table: Table, features: Callable[[LabelledSet], torch.Tensor], seeds: int, grid: int
) -> Cells:
    """Return a row of the table: per transfer the mean over ``seeds`` heads."""
    frozen = {sensor: features(labelled) for sensor, labelled in table.frozen.items()}
    cells: dict[str, list[dict[str, list[float]]]] = {}
    for source in table.training:
        z = features(table.training[source])
        for seed in range(seeds):
            head = train_head(
                z, table.training[source].force_N, sized_head(table.head, z, grid), seed
            )
            for target in table.frozen:
                cell = score(table.frozen[target].force_N, predict(head, frozen[target]))
                cells.setdefault(transfer_name(source, target), []).append(cell)
    return mean_cells(cells)


def mean_row(table: Table) -> Cells:
    row: Cells = {}
    for source, target in table.transfers():
        mean = table.training[source].force_N.reshape(-1, 3).mean(axis=0)
        truth = table.frozen[target].force_N
        row[transfer_name(source, target)] = score(truth, np.broadcast_to(mean, truth.shape))
    return row


@torch.no_grad()
def predict(head: ForceRegressor, z: torch.Tensor) -> np.ndarray:
    """Return (n, T, 3) N."""
    return head(z).numpy()


def score(truth_N: np.ndarray, said_N: np.ndarray) -> dict[str, list[float]]:
    """Return R², |r| and MAE per axis over all frames; R² and MAE within the paper's range, too."""
    small = within(truth_N)
    return {
        "abs_r": abs_r(truth_N.reshape(-1, 3), said_N.reshape(-1, 3)),
        "r2": _r2(truth_N.reshape(-1, 3), said_N.reshape(-1, 3)),
        "mae_N": _mae(truth_N.reshape(-1, 3), said_N.reshape(-1, 3)),
        "r2_paper_range": _r2(truth_N[small], said_N[small]),
        "mae_N_paper_range": _mae(truth_N[small], said_N[small]),
    }


def across(row: Cells, key: str) -> np.ndarray:
    """Return one score per axis, (transfers, 3), of the transfers between different sensors."""
    return np.array([cell[key] for name, cell in row.items() if len(set(name.split("->"))) == 2])


def summary(row: Cells) -> dict[str, float]:
    """Return a row's means and worst cells over transfers between different sensors."""
    r2, mae = across(row, "r2"), across(row, "mae_N_paper_range").mean(axis=0)
    return {
        "fz_mean": float(r2[:, 2].mean()),
        "fz_worst": float(r2[:, 2].min()),
        "shear_mean": float(r2[:, :2].mean()),
        "shear_worst": float(r2[:, :2].min()),
        "mean": float(r2.mean()),
        "mae_fx_N": float(mae[0]),
        "mae_fy_N": float(mae[1]),
        "mae_fz_N": float(mae[2]),
    }


def shipped_cell(
    head: ForceHead, tokenizer: Tokenizer, labelled: LabelledSet
) -> dict[str, list[float]]:
    """Return the score of a shipped head on another sensor's frozen set."""
    return score(labelled.force_N, head.sequence(encode_set(tokenizer, labelled)).numpy())


def sized_head(config: HeadTrainingConfig, z: torch.Tensor, grid: int) -> HeadTrainingConfig:
    """Return ``config`` with the head's input sized for features (n, T, P, L) on a square grid."""
    return replace(config, head=replace(config.head, channels=z.shape[-1], grid=grid))


def _r2(truth: np.ndarray, said: np.ndarray) -> list[float]:
    residual = ((truth - said) ** 2).sum(axis=0)
    spread = ((truth - truth.mean(axis=0)) ** 2).sum(axis=0)
    return [float(v) for v in 1 - residual / spread]


def abs_r(truth: np.ndarray, said: np.ndarray) -> list[float]:
    """Return |correlation|: what is left when gain and offset are forgiven; 0 of a constant."""
    a, b = truth - truth.mean(axis=0), said - said.mean(axis=0)
    length = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    return [float(v) for v in np.abs((a * b).sum(axis=0)) / np.maximum(length, 1e-12)]


def _mae(truth: np.ndarray, said: np.ndarray) -> list[float]:
    return [float(v) for v in np.abs(truth - said).mean(axis=0)]


def mean_cells(scores: dict[str, list[dict[str, list[float]]]]) -> Cells:
    """Return the mean over seeds of every number: one score per seed in, one cell out."""
    return {
        name: {
            key: [float(v) for v in np.mean([one[key] for one in seeds], axis=0)]
            for key in seeds[0]
        }
        for name, seeds in scores.items()
    }
