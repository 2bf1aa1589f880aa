"""Cells of a row whose whole network is fitted to the source sensor: ResNet, fine-tuning, translation."""

from collections.abc import Callable

from benchmarks.baselines.pictures import Predictor, pictures
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import Cells, Table, mean_cells, score, transfer_name
from uniforce_vtla.errors import ContractError, expected

Fit = Callable[[LabelledSet, int], Predictor]  # source set, seed → predictor
Scores = dict[str, list[dict[str, list[float]]]]  # transfer → one score per seed


def fitted_row(table: Table, fit: Fit, seeds: int) -> Cells:
    """Return a row: ``fit`` on every source, scored on every target's pictures, mean over ``seeds``.

    Raises:
        ContractError: no seed, or a set that can't be used.
    """
    scores: Scores = {}
    for source, labelled in table.training.items():
        for seed in range(check_seeds(seeds)):
            predict = fit(labelled, seed)
            for target in table.frozen:
                add_score(scores, table, (source, target), predict)
    return mean_cells(scores)


def add_score(scores: Scores, table: Table, transfer: tuple[str, str], predict: Predictor) -> None:
    """Append one seed's score of ``transfer``; the target's labels meet the prediction here and nowhere else."""
    target = transfer[1]
    said = predict(pictures(table.frozen[target]))
    scores.setdefault(transfer_name(*transfer), []).append(score(table.forces(target), said))


def check_seeds(seeds: int) -> int:
    """Return ``seeds``; ContractError if there is none."""
    if seeds < 1:
        raise ContractError(expected("seeds", "at least 1", seeds, "The table uses 3."))
    return seeds
