"""Cells of a row whose whole network is fitted to the source sensor; it may look at pictures, never at labels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import Cells, Table, mean_cells, score, transfer_name
from uniforce_vtla.errors import ContractError, expected


@dataclass(frozen=True)
class Pictures:
    """The images of a labelled set, without its forces: a predictor can't read what it isn't given."""

    reference: np.ndarray  # (n, S, S) uint8
    frames: np.ndarray  # (n, T, S, S) uint8

    def tensors(
        self, rows: np.ndarray | slice, frames: slice = slice(None)
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return references (B, 1, S, S) and frames (B, F, S, S), float32 in [0, 1]."""
        return _floats(self.reference[rows][:, None]), _floats(self.frames[rows][:, frames])


Predictor = Callable[[Pictures], np.ndarray]  # → (n, T, 3) N


def pictures(labelled: LabelledSet) -> Pictures:
    return Pictures(labelled.reference, labelled.frames)


def labels(labelled: LabelledSet) -> torch.Tensor:
    """Return a *source* set's forces, (n, T, 3) float32 N; ContractError: a force that isn't finite."""
    if not bool(np.isfinite(labelled.force_N).all()):
        raise ContractError(
            expected("forces of the source", "finite", "NaN or inf", "Check the set.")
        )
    return torch.from_numpy(labelled.force_N).float()


def _floats(images: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(images)).float() / 255


Fit = Callable[[LabelledSet, int], Predictor]  # source set, seed → predictor


def fitted_row(table: Table, fit: Fit, seeds: int) -> Cells:
    """Return a row: ``fit`` on every source, scored on every target's pictures, mean over ``seeds``."""
    scores: dict[str, list[dict[str, list[float]]]] = {}  # transfer → one score per seed
    for source, labelled in table.training.items():
        for seed in range(seeds):
            predict = fit(labelled, seed)
            # its labels meet the prediction here and nowhere else
            for target, shown in table.frozen.items():
                found = score(shown.force_N, predict(pictures(shown)))
                scores.setdefault(transfer_name(source, target), []).append(found)
    return mean_cells(scores)
