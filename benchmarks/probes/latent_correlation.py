"""Does the latent hold force?  Correlation of the pad's mean latent with Fx, Fy, Fz (UniForce paper, Q1).

Labels are looked at once: an orthogonal rotation of the latent's axes is fitted on the training set of *one* source
sensor.  The same rotation then serves every sensor, on indenters nobody was fitted to.  Which axis stands for which
force is decided on the source too: the greatest r of each sensor by itself would be picking.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from scipy import optimize, stats

from benchmarks.probes.labelled_set import LabelledSet
from uniforce_vtla.contact.sampling import sample_objects
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS

FORCES = ("fx", "fy", "fz")
SOURCE = "tactip"  # the sensor both pretraining rigs share
Features = Callable[[LabelledSet], np.ndarray]  # a set → (n, T, L)
FEWEST = 4  # frames an r is worth computing from
CONSTANT = 1e-9  # spread below which a latent tells nothing; its r is then 0


class Recipe(Protocol):
    """What of a labelled set's recipe decides its indenters."""

    @property
    def seed(self) -> int:
        """Seed of everything drawn."""

    @property
    def sequences(self) -> int:
        """Number of sequences."""

    @property
    def indenters(self) -> tuple[str, ...]:
        """Names drawn from."""


@dataclass(frozen=True)
class Rotation:
    """Orthogonal change of the latent's axes: ``z @ matrix`` carries fx, fy, fz on its first three.

    Attributes:
        source: the sensor whose labels it was fitted to.
        matrix: (L, L) orthogonal.
    """

    source: str
    matrix: np.ndarray

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Return latents (..., L) on the new axes."""
        return z @ self.matrix


def indenters_of(recipe: Recipe) -> tuple[str, ...]:
    """Return the indenter's name per sequence of a labelled set: they are the first thing its seed draws."""
    rng = np.random.default_rng(recipe.seed)
    return sample_objects(rng, recipe.sequences, recipe.indenters).names


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
    if the latent were as wide in every direction: a little of a loud shear drowns a faint normal force.  What is left
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
        raise ContractError(
            expected("latent", "three directions that carry force", "fewer", "Train it first.")
        )
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


def pearson(z: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Return (L, 3) Pearson r of every latent with every force, over all frames.

    0 where a latent is constant: it tells nothing.

    Raises:
        ContractError: shapes that don't go together, non-finite values, a force that never changes.
    """
    latent, force = _paired(z, force_N)
    latent, force = latent - latent.mean(axis=0), force - force.mean(axis=0)
    spread = np.sqrt((latent**2).sum(axis=0)), np.sqrt((force**2).sum(axis=0))
    if spread[1].min() < CONSTANT:
        raise ContractError(expected("force", "labels that vary", "a constant axis", "Add contacts."))
    covariance = latent.T @ force
    scale = spread[0][:, None] * spread[1]
    return np.where(spread[0][:, None] > CONSTANT, covariance / np.maximum(scale, CONSTANT**2), 0.0)


def assigned_axes(z: np.ndarray, force_N: np.ndarray) -> list[int]:
    """Return per force the latent with the greatest |r|; ask it on the source's training set only."""
    return [int(axis) for axis in np.abs(pearson(z, force_N)).argmax(axis=0)]


def per_newton(z: np.ndarray, force_N: np.ndarray) -> np.ndarray:
    """Return (3,) how much the first three axes of (..., L) change per newton of their own force."""
    latent, force = _paired(z, force_N)
    centred = force - force.mean(axis=0)
    return (latent[:, :3] * centred).sum(axis=0) / (centred**2).sum(axis=0)


def correlations(z: np.ndarray, force_N: np.ndarray, indenters: Sequence[str]) -> dict[str, Any]:
    """Return r of every latent with every force on one sensor's set.

    Args:
        z: (n, T, L) pad latents.
        force_N: (n, T, 3).
        indenters: (n,) names.

    Returns:
        ``r`` (L, 3) over all frames; ``mean`` and ``sd`` (L, 3) over the indenters' own r; ``by_indenter``; counts;
        ``p_frames``, which takes frames of a sequence for independent and so flatters; ``p_indenters``, a t test of
        the indenters' Fisher-z against 0.

    Raises:
        ContractError: as ``pearson``, or another number of names than sequences.
    """
    if len(indenters) != len(z):
        raise ContractError(expected("indenters", f"{len(z)} names", len(indenters), "One per sequence."))
    names = sorted(set(indenters))
    own = np.asarray(indenters)
    each = np.stack([pearson(z[own == name], force_N[own == name]) for name in names])  # (I, L, 3)
    r, frames = pearson(z, force_N), z.shape[0] * z.shape[1]
    return {
        "r": r.tolist(),
        "mean": each.mean(axis=0).tolist(),
        "sd": each.std(axis=0, ddof=1).tolist() if len(names) > 1 else None,
        "by_indenter": {name: values.tolist() for name, values in zip(names, each, strict=True)},
        "frames": frames,
        "sequences": len(z),
        "indenters": len(names),
        "p_frames": _p_frames(r, frames).tolist(),
        "p_indenters": _p_indenters(each).tolist() if len(names) > 1 else None,
    }


def latent_correlation(
    tokenizer: Tokenizer,
    training: LabelledSet,
    unseen: Mapping[str, LabelledSet],
    indenters: Mapping[str, Sequence[str]],
    source: str = SOURCE,
) -> dict[str, Any]:
    """Return the whole of Q1: every sensor before and after the source's rotation.

    Args:
        tokenizer: what is examined.
        training: the source's training set, seen indenters: the only labels that choose anything.
        unseen: sensor name → its set of unseen indenters; any sensors.
        indenters: sensor name → (n,) names, see ``indenters_of``.
        source: name of the training set's sensor.

    Returns:
        ``best_abs_r`` {sensor: [fx, fy, fz]}: |r| over all frames (the paper's r) of the one axis that stands for
        that force; ``best_mean_sd`` the same axes' mean ± SD over indenters; both again ``…_unrotated``;
        ``hand_descriptor_abs_r`` what six hand-made numbers reach under the same rules, rotated or not.
        ``gain_over_source`` {sensor: [fx, fy, fz]}: the same axis' change per newton, over the source's.  r can't
        see it, and a head that moves from sensor to sensor needs it near 1.

    Raises:
        ContractError: no names for a sensor, and as ``fit_rotation``.
    """
    missing = sorted(set(unseen) - set(indenters))
    if missing:
        raise ContractError(
            expected("indenters", f"names for {sorted(unseen)}", f"none for {missing}", "Add them.")
        )

    def table(features: Features) -> dict[str, Any]:
        fitted, forces = features(training), training.force_N
        rotation = fit_rotation(fitted, forces, source)
        z = {sensor: features(labelled) for sensor, labelled in unseen.items()}
        sides = {}
        for side, turn, axes in (
            ("before", Rotation(source, np.eye(fitted.shape[-1])), assigned_axes(fitted, forces)),
            ("after", rotation, [0, 1, 2]),
        ):
            found = {s: correlations(turn(z[s]), unseen[s].force_N, indenters[s]) for s in z}
            sides[side] = {"axes": axes, "sensors": found}
        turned = rotation(fitted)
        scale = per_newton(turned, forces)
        gains = {s: (per_newton(rotation(z[s]), unseen[s].force_N) / scale).tolist() for s in z}
        on_source = np.abs(pearson(turned, forces)).diagonal().tolist()
        facts = {"rotation": rotation.matrix.tolist(), "source_abs_r": on_source, "gain_over_source": gains}
        return sides | facts

    found, by_hand = table(lambda s: pad_latent(tokenizer, s)), table(_descriptor)
    after, before = found["after"], found["before"]
    return {
        "what": "simulated; Pearson r of the pad's mean latent with force; unseen indenters",
        "source": source,
        "source_frames": int(np.prod(training.force_N.shape[:2])),
        "tokenizer_hash": tokenizer.hash,
        "best_abs_r": _best(after, "r"),
        "best_mean_sd": _best_mean_sd(after),
        "best_abs_r_unrotated": _best(before, "r"),
        "best_mean_sd_unrotated": _best_mean_sd(before),
        "over_sensors": _over_sensors(_best(after, "r")),
        "hand_descriptor_abs_r": {side: _best(by_hand[side], "r") for side in ("before", "after")},
        "hand_descriptor_gain_over_source": by_hand["gain_over_source"],
    } | found


def _descriptor(labelled: LabelledSet) -> np.ndarray:
    """Return (n, T, 6) hand descriptors in natural units."""
    return labelled.descriptor.astype(np.float64) / np.asarray(NATURAL_UNITS)


def _best(side: dict[str, Any], key: str) -> dict[str, list[float]]:
    """Return per sensor the |value| of each force's own axis."""
    return {
        sensor: [abs(found[key][axis][force]) for force, axis in enumerate(side["axes"])]
        for sensor, found in side["sensors"].items()
    }


def _best_mean_sd(side: dict[str, Any]) -> dict[str, dict[str, list[float]]]:
    means = _best(side, "mean")
    if any(found["sd"] is None for found in side["sensors"].values()):
        return {sensor: {"mean_abs_r": means[sensor]} for sensor in means}
    sds = _best(side, "sd")
    return {sensor: {"mean_abs_r": means[sensor], "sd": sds[sensor]} for sensor in means}


def _over_sensors(best: dict[str, list[float]]) -> dict[str, list[float]]:
    """Return mean and SD over sensors per force: the paper's ±."""
    values = np.array(list(best.values()))  # (sensors, 3)
    return {"mean": values.mean(axis=0).tolist(), "sd": values.std(axis=0).tolist()}


def _paired(z: np.ndarray, force_N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, L) and (N, 3) float64 of latents and forces that belong together."""
    z, force_N = np.asarray(z, np.float64), np.asarray(force_N, np.float64)
    fits = z.shape[:-1] == force_N.shape[:-1] and force_N.shape[-1:] == (3,) and z[..., 0].size >= FEWEST
    if not fits or not (np.isfinite(z).all() and np.isfinite(force_N).all()):
        came = f"{z.shape} and {force_N.shape}" if not fits else "NaN or inf"
        raise ContractError(
            expected(
                "latents, forces", f"finite (..., L) and (..., 3), ≥ {FEWEST} frames", came, "Check the set."
            )
        )
    return z.reshape(-1, z.shape[-1]), force_N.reshape(-1, 3)


def _p_frames(r: np.ndarray, n: int) -> np.ndarray:
    """Return the two-sided p of Pearson's r over ``n`` independent frames."""
    bounded = np.clip(np.abs(r), 0, 1 - 1e-12)
    return 2 * stats.t.sf(bounded * np.sqrt((n - 2) / (1 - bounded**2)), n - 2)


def _p_indenters(each: np.ndarray) -> np.ndarray:
    """Return the two-sided p that the mean Fisher-z over indenters (I, L, 3) isn't 0; 1 where all r are 0."""
    fisher = np.arctanh(np.clip(each, -1 + 1e-12, 1 - 1e-12))
    error = fisher.std(axis=0, ddof=1) / np.sqrt(len(each))
    t = np.abs(fisher.mean(axis=0)) / np.maximum(error, 1e-12)
    return 2 * stats.t.sf(t, len(each) - 1)
