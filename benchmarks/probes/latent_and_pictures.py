"""Does the latent hold force (Q1)? Does it redraw what the other finger saw (Q2)? Unseen indenters."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy import optimize

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import Table, abs_r
from uniforce_vtla.contact import UNSEEN, PairSettings, equilibrium_pairs
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.pair_cache import shrink

FEWEST = 4  # frames a rotation can be fitted to
CONSTANT = 1e-9  # spread below which a latent carries nothing
SOURCE = "tactip"  # the sensor of both pretraining rigs; its labels fit the one rotation
# the last one in no pretraining
RIGS = (("gelsight", "tactip"), ("uskin", "tactip"), ("gelsight_d", "tactip"))
PAIRS_SEED = 7_003
BRANCHES = ((0, 0), (1, 1), (1, 0), (0, 1))  # (whose latent, whose picture)


def pad_latent(tokenizer: Tokenizer, labelled: LabelledSet) -> np.ndarray:
    """Return (n, T, L) float64 latents, averaged over all patches (worn on the left finger)."""
    rows = [
        tokenizer.encode(before, after).mean(dim=1)
        for before, after in zip(labelled.reference, labelled.frames, strict=True)
    ]
    return torch.stack(rows).double().numpy()


def fit_rotation(z: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Return (L, L), orthogonal: ``z @ rotation`` carries fx, fy, fz on its first three axes.

    The first three axes are the orthonormal triple whose squared correlations with Fx, Fy, Fz sum to the most.  The
    search starts at the nearest triple (Procrustes) to the three regression directions; that one alone would do only
    if the latent were as wide in every direction: a little of a strong shear hides a weak normal force.  The rest
    of the space is filled with its own principal axes.

    ``z`` are (..., L) latents of a sensor's training set, L ≥ 3, ``force_N`` is (..., 3).

    Raises ContractError: shapes that don't go together, non-finite values, latents that hold no three directions.
    """
    latent, force = _paired(z, force_N)
    centred = latent - latent.mean(axis=0)
    direction, *_ = np.linalg.lstsq(centred, force - force.mean(axis=0), rcond=None)  # (L, 3)
    length = np.linalg.norm(direction, axis=0)
    if latent.shape[1] < 3 or length.min() < CONSTANT:
        raise ContractError(
            expected("latent", "three directions that carry force", "fewer", "Train it first.")
        )
    carries = _most_correlated(
        centred, force - force.mean(axis=0), _orthonormal(direction / length)
    )
    rest = np.linalg.svd(carries, full_matrices=True)[0][:, 3:]
    _, principal = np.linalg.eigh(np.cov(centred @ rest, rowvar=False).reshape(len(rest[0]), -1))
    matrix = np.concatenate([carries, rest @ principal[:, ::-1]], axis=1)
    if matrix.shape[1] > 3 and np.linalg.det(matrix) < 0:
        matrix[:, -1] *= -1  # a rotation, not a reflection
    return matrix


def _orthonormal(directions: np.ndarray) -> np.ndarray:
    """Return the orthonormal columns nearest to those of (L, 3)."""
    left, _, right = np.linalg.svd(directions, full_matrices=False)
    return left @ right


def _most_correlated(latent: np.ndarray, force: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return (L, 3) orthonormal axes of the greatest Σ r² with the three forces; inputs centred, a local search."""
    scale = np.sqrt(np.trace(latent.T @ latent) / latent.size)
    unit = latent / scale
    spread, shared = unit.T @ unit / len(unit), unit.T @ (force / force.std(axis=0)) / len(unit)

    def lost(entries: np.ndarray) -> float:
        axes = _orthonormal(entries.reshape(start.shape))
        r2 = (axes * shared).sum(axis=0) ** 2 / (axes * (spread @ axes)).sum(axis=0)
        return -float(r2.sum())

    found = optimize.minimize(lost, start.ravel(), method="BFGS")
    return _orthonormal(found.x.reshape(start.shape))


def _paired(z: np.ndarray, force_N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, L) and (N, 3) float64 of latents and forces that belong together."""
    z, force_N = np.asarray(z, np.float64), np.asarray(force_N, np.float64)
    fits = (
        z.shape[:-1] == force_N.shape[:-1]
        and force_N.shape[-1:] == (3,)
        and z[..., 0].size >= FEWEST
    )
    if not fits or not (np.isfinite(z).all() and np.isfinite(force_N).all()):
        came = f"{z.shape} and {force_N.shape}" if not fits else "NaN or inf"
        raise ContractError(
            expected(
                "latents, forces",
                f"finite (..., L) and (..., 3), ≥ {FEWEST} frames",
                came,
                "Check the set.",
            )
        )
    return z.reshape(-1, z.shape[-1]), force_N.reshape(-1, 3)


def latent_correlation(tokenizer: Tokenizer, table: Table) -> dict[str, Any]:
    """Return |r| of the rotated pad latent's axes with Fx, Fy, Fz per sensor, and of hand descriptors turned alike.

    One rotation, fitted to the source's training set; the axes stand for the same forces on every sensor.
    """

    def per_sensor(features: Any) -> dict[str, list[float]]:
        rotation = fit_rotation(features(table.training[SOURCE]), table.training[SOURCE].force_N)
        return {
            name: abs_r(
                (features(labelled) @ rotation)[..., :3].reshape(-1, 3),
                labelled.force_N.reshape(-1, 3),
            )
            for name, labelled in table.frozen.items()
        }

    return {
        "what": "simulated; |r| of Fx, Fy, Fz with their axes, unseen indenters",
        "source": SOURCE,
        "best_abs_r": per_sensor(lambda s: pad_latent(tokenizer, s)),
        "hand_descriptor": per_sensor(
            lambda s: s.descriptor.astype(np.float64) / np.asarray(NATURAL_UNITS)
        ),
    }


@torch.no_grad()
def reconstructions(tokenizer: Tokenizer, pairs: int, picture: Path) -> dict[str, Any]:
    """Return grey-level errors of the four branches beside copying the reference, and draw each rig's median pair."""
    found: dict[str, Any] = {
        "what": "simulated pairs, unseen indenters and units; mean |grey error| over copying's"
    }
    rows, side = [], tokenizer.config.side
    for left, right in RIGS:
        rng = np.random.default_rng(PAIRS_SEED)
        settings = PairSettings(pairs_per_unit=4)
        batch = equilibrium_pairs(
            rng, pairs, left, right, UNSEEN, settings, lambda images: shrink(images, side)
        )
        before = [
            _model_input(batch.left_reference, "left"),
            _model_input(batch.right_reference, "right"),
        ]
        after = [
            _model_input(batch.left_current, "left"),
            _model_input(batch.right_current, "right"),
        ]
        z = [tokenizer.model.encoder(b, a).mean for b, a in zip(before, after, strict=True)]
        drawn = {(i, j): tokenizer.model.decoder(before[j], z[i]) for i, j in BRANCHES}
        copied = [(before[j] - after[j]).abs().mean(dim=(1, 2, 3)) for j in range(2)]
        errors = {
            way: (said - after[way[1]]).abs().mean(dim=(1, 2, 3)) for way, said in drawn.items()
        }
        names = {
            f"{'LR'[i]}->{'LR'[j]}": float(e.mean() / copied[j].mean())
            for (i, j), e in errors.items()
        }
        found[f"{left}+{right}"] = names | {
            "cross_over_self": [
                float(errors[1 - j, j].mean() / errors[j, j].mean()) for j in range(2)
            ]
        }
        median = int(np.argsort((errors[1, 0] + errors[0, 1]).numpy())[pairs // 2])
        rows.append(
            [
                *(
                    p[median, 0]
                    for j in range(2)
                    for p in (before[j], after[j], drawn[j, j], drawn[1 - j, j])
                )
            ]
        )
    _draw(rows, picture)
    return found


def _model_input(images: np.ndarray, finger: Any) -> torch.Tensor:
    return to_canonical(torch.from_numpy(images)[:, None].float() / 255, finger)


def _draw(rows: list[list[torch.Tensor]], path: Path) -> None:
    titles = [
        f"{side} {what}"
        for side in "LR"
        for what in ("reference", "current", "own latent", "other's latent")
    ]
    figure = Figure(figsize=(2 * len(titles), 1.7 * len(rows) + 0.5), layout="constrained")
    grid = figure.subplots(len(rows), len(titles), squeeze=False)
    for line, images, rig in zip(grid, rows, RIGS, strict=True):
        for axes, image, title in zip(line, images, titles, strict=True):
            axes.imshow(image.numpy(), cmap="gray", vmin=0, vmax=1)
            axes.set(xticks=[], yticks=[], title=title)
        line[0].set_ylabel(" + ".join(rig))
    save_figure(figure, path)
