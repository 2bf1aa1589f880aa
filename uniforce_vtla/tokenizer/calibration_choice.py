"""Choose no calibration or a map of the latent, by left-out grasps.

A map helps between units of one sensor type. It can do harm where grasps were few, or of other
objects than those to come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import Latent
from uniforce_vtla.tokenizer.latent_map import LatentMap, fit_map, folds, grasp_numbers

FORMS = ("none", "map")
# Standard errors by which a map must be better than none. With three, GelSights 2 and 3 would stay
# at .82 and .78 of a held tool's shear; their maps give .90 and .94, and a policy presses by it.
SURE = 1.0
# With six or seven real objects the folds chose forms that read other objects worse.
FEWEST_GRASPS = 20
AXES = (0, 1, 2)


@dataclass(frozen=True)
class Choice:
    """The form that reads left-out grasps best, and the error of each form.

    The error of a grasp is the mean squared difference of both fingers' newtons. Each axis is
    divided by the anchor's variance: shear counts as much as grip, and 1 is as bad as the mean.
    """

    form: str  # one of FORMS
    error: dict[str, float]  # of each form, mean over grasps
    standard_error: dict[str, float]  # over grasps, of the difference to none
    grasps: int


def newtons(head: ForceHead, z: torch.Tensor) -> np.ndarray:
    """Return (n, 3) N that the head reads of latents (n, P, L) of its own tokenizer."""
    return head(Latent.of(z, head.tokenizer_hash)).numpy()


def fit_form(
    form: str, z_new: torch.Tensor, z_anchor: torch.Tensor, grasps: np.ndarray
) -> tuple[LatentMap, float]:
    """Fit one of ``FORMS`` to paired latents (n, P, L) of numbered grasps (n,); also its ridge."""
    if form == "map":
        return fit_map(z_new, z_anchor, grasps)
    return LatentMap(*z_new.shape[1:]).eval(), 0.0


def _read_left_out(
    z_new: torch.Tensor, z_anchor: torch.Tensor, head: ForceHead, grasps: np.ndarray
) -> np.ndarray:
    """Return (n, 3) N through maps that were fitted without the row's own fold of grasps."""
    read_N = np.zeros((len(z_new), 3), np.float32)
    fold = folds(grasps)
    for number in np.unique(fold):
        out = fold == number
        latent_map, _ = fit_map(z_new[~out], z_anchor[~out], grasps[~out])
        read_N[out] = newtons(head, latent_map(z_new[out]))
    return read_N


def error_of_grasps(
    read_N: np.ndarray, known_N: np.ndarray, grasps: np.ndarray, axes: Sequence[int]
) -> np.ndarray:
    """Return (grasps,) the error of each grasp (see ``Choice``) of readings (n, 3) in N."""
    spread = np.maximum(known_N.var(axis=0), 1e-12)
    of_row = ((read_N - known_N) ** 2 / spread)[:, list(axes)].mean(axis=1)  # (n,)
    return np.bincount(grasps, of_row) / np.bincount(grasps)


def choose_form(
    z_new: torch.Tensor,
    z_anchor: torch.Tensor,
    head: ForceHead,
    grasps: Sequence[int] | np.ndarray | None = None,
    axes: Sequence[int] = AXES,
) -> Choice:
    """Return which of ``FORMS`` reads left-out grasps best; rows of a grasp are left out together.

    A map must be better than none by ``SURE`` standard errors of the difference over grasps. Fewer
    than ``FEWEST_GRASPS`` choose none.

    Args:
        z_new: (n, P, latent) of the sensor to calibrate, from the head's tokenizer.
        z_anchor: (n, P, latent) of the known sensor on the same grasps.
        head: reads both in newtons.
        grasps: (n,) number of the grasp of each row; None where each row is a grasp of its own.
        axes: which of x, y, z are equal on both fingers.

    Raises ContractError: a single grasp.
    """
    of_grasp = grasp_numbers(grasps, len(z_new))
    if (count := len(np.unique(of_grasp))) < 2:
        raise ContractError(
            expected("grasps to choose a calibration by", "2 or more", count, "Grasp more often.")
        )

    known_N = newtons(head, z_anchor)
    read_N = _read_left_out(z_new, z_anchor, head, of_grasp)
    before = error_of_grasps(newtons(head, z_new), known_N, of_grasp, axes)  # (grasps,)
    after = error_of_grasps(read_N, known_N, of_grasp, axes)
    noise = _standard_error(before - after)
    is_better = count >= FEWEST_GRASPS and (before - after).mean() > SURE * noise
    return Choice(
        form="map" if is_better else "none",
        error={"none": float(before.mean()), "map": float(after.mean())},
        standard_error={"none": 0.0, "map": noise},
        grasps=count,
    )


def read_choice(stored: dict[str, Any]) -> Choice:
    """Return a choice stored with ``dataclasses.asdict``.

    Raises KeyError, TypeError or ValueError: it is none.
    """
    if stored["form"] not in FORMS:
        raise ValueError(f"form {stored['form']}")
    error = {}
    noise = {}
    for form in FORMS:
        error[form] = float(stored["error"][form])
        noise[form] = float(stored["standard_error"][form])
    return Choice(stored["form"], error, noise, int(stored["grasps"]))


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))
