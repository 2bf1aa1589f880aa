"""The axes of the latent that follow force: a rotation fitted once, on one simulated sensor's labels."""

from dataclasses import dataclass

import numpy as np
import torch
from scipy import optimize

from benchmarks.probes.labelled_set import LabelledSet
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.api import Tokenizer

FEWEST = 4  # frames a rotation can be fitted to
CONSTANT = 1e-9  # spread below which a latent carries nothing


@dataclass(frozen=True)
class Rotation:
    """Orthogonal change of the latent's axes: ``z @ matrix`` carries fx, fy, fz on its first three."""

    source: str  # the sensor whose labels it was fitted to
    matrix: np.ndarray  # (L, L) orthogonal

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Return latents (..., L) on the new axes."""
        return z @ self.matrix


def pad_latent(tokenizer: Tokenizer, labelled: LabelledSet) -> np.ndarray:
    """Return (n, T, L) float64 latents, averaged over all patches (worn on the left finger)."""
    rows = [
        tokenizer.encode(before, after).mean(dim=1)
        for before, after in zip(labelled.reference, labelled.frames, strict=True)
    ]
    return torch.stack(rows).double().numpy()


def fit_rotation(z: np.ndarray, force_N: np.ndarray, source: str) -> Rotation:
    """Return the rotation that lines the latent's axes up with force.

    The first three axes are the orthonormal triple whose squared correlations with Fx, Fy, Fz sum to the most.  The
    search starts at the nearest triple (Procrustes) to the three regression directions; that one alone would do only
    if the latent were as wide in every direction: a little of a strong shear hides a weak normal force.  What is left
    of the space is filled with its own principal axes.

    Args:
        z: (..., L) latents of the source's training set, L ≥ 3.
        force_N: (..., 3).
        source: the sensor's name.

    Raises:
        ContractError: shapes that don't go together, non-finite values, latents that hold no three directions.
    """
    latent, force = _paired(z, force_N)
    centred = latent - latent.mean(axis=0)
    direction, *_ = np.linalg.lstsq(centred, force - force.mean(axis=0), rcond=None)  # (L, 3)
    length = np.linalg.norm(direction, axis=0)
    if latent.shape[1] < 3 or length.min() < CONSTANT:
        raise ContractError(expected("latent", "three directions that carry force", "fewer", "Train it first."))
    carries = _most_correlated(centred, force - force.mean(axis=0), _orthonormal(direction / length))
    rest = np.linalg.svd(carries, full_matrices=True)[0][:, 3:]
    _, principal = np.linalg.eigh(np.cov(centred @ rest, rowvar=False).reshape(len(rest[0]), -1))
    matrix = np.concatenate([carries, rest @ principal[:, ::-1]], axis=1)
    if matrix.shape[1] > 3 and np.linalg.det(matrix) < 0:
        matrix[:, -1] *= -1  # a rotation, not a reflection
    return Rotation(source, matrix)


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
    fits = z.shape[:-1] == force_N.shape[:-1] and force_N.shape[-1:] == (3,) and z[..., 0].size >= FEWEST
    if not fits or not (np.isfinite(z).all() and np.isfinite(force_N).all()):
        came = f"{z.shape} and {force_N.shape}" if not fits else "NaN or inf"
        raise ContractError(
            expected("latents, forces", f"finite (..., L) and (..., 3), ≥ {FEWEST} frames", came, "Check the set.")
        )
    return z.reshape(-1, z.shape[-1]), force_N.reshape(-1, 3)
