"""Label-free calibration: fit a new sensor's latents to the known one's on the same grasps.

Both fingers grasp an externally held object for two minutes, half the time small objects, half the
time tools. Their forces are equal, so their latents should be. The difference depends on the place
on the pad, so one linear map of the whole pooled latent is fitted, ridge-regressed towards the
identity. No force is measured.

The map is used only if left-out grasps are read better with it (``calibration_choice.py``).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np
import torch

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.calibration import Agreement, Calibration
from uniforce_vtla.tokenizer.calibration_choice import choose_form, fit_form, newtons
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import own_latent
from uniforce_vtla.tokenizer.latent_map import grasp_numbers
from uniforce_vtla.tokenizer.mount_relation import SETTINGS, mount_relation
from uniforce_vtla.tokenizer.settings import OBJECT_CLASSES, CalibrationConfig

FEWEST_GRASPS = 3  # of a class: one judges, two choose
logger = logging.getLogger(__name__)


def calibrate(
    z_new: torch.Tensor,
    z_anchor: torch.Tensor,
    classes: Sequence[str],
    head: ForceHead,
    new: str,
    anchor: str,
    config: CalibrationConfig | None = None,
    grasps: Sequence[int] | None = None,
) -> Calibration:
    """Choose and fit a map or nothing to paired pooled latents.

    Judge it on held-out grasps.

    Args:
        z_new: (n, P, latent) of the sensor to calibrate, canonical frame.
        z_anchor: (n, P, latent) of the known sensor on the other finger.
        classes: (n) class of the grasped object: "small" or "tool".
        head: force head of the anchor; it reads both fingers for the judgement.
        new: name of the sensor to calibrate.
        anchor: name of the known one.
        config: share held out, fewest pairs, seed.
        grasps: (n) number of the grasp that a row is of; None where each row is a grasp of its own.

    Raises ContractError: too few pairs or grasps of a class, different shapes, NaN, no origin,
    grasps that never load the sensors, or a sensor mounted turned by 180° or mirrored;
    CheckpointError: latents of another tokenizer than the head's.
    """
    config = config or CalibrationConfig()
    own_new = own_latent(z_new, head.tokenizer_hash, "calibration")
    own_anchor = own_latent(z_anchor, head.tokenizer_hash, "calibration")
    names = np.asarray(classes)
    of_grasp = grasp_numbers(grasps, len(names))
    _check(own_new, own_anchor, names, of_grasp, config)
    judge, fit = _split(names, of_grasp, config)
    choice = choose_form(own_new[fit], own_anchor[fit], head, of_grasp[fit])
    latent_map, ridge = fit_form(choice.form, own_new[fit], own_anchor[fit], of_grasp[fit])
    truth_N = newtons(head, own_anchor[judge])
    before_N = newtons(head, own_new[judge])
    after_N = newtons(head, latent_map(own_new[judge]))
    _refuse_other_mount(before_N[:, :2], truth_N[:, :2], new, anchor)
    agreement = {}
    for kind in OBJECT_CLASSES:
        is_kind = names[judge] == kind
        agreement[kind] = Agreement(
            grasps=len(np.unique(of_grasp[judge][is_kind])),
            r2=_r2(truth_N[is_kind], after_N[is_kind]),
            abs_r=_abs_r(truth_N[is_kind], after_N[is_kind]),
            r2_before=_r2(truth_N[is_kind], before_N[is_kind]),
        )
    return Calibration(
        map=latent_map,
        tokenizer_hash=head.tokenizer_hash,
        head_hash=head.hash,
        new=new,
        anchor=anchor,
        ridge=ridge,
        turn_deg=math.degrees(in_plane_turn_rad(before_N[:, :2], truth_N[:, :2])),
        agreement=agreement,
        choice=choice,
    )


def in_plane_turn_rad(read: np.ndarray, known: np.ndarray) -> float:
    """Return the turn, x towards y, from (n, 2) readings to known vectors (Procrustes)."""
    a = read - read.mean(axis=0)
    b = known - known.mean(axis=0)
    return float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))


def _refuse_other_mount(read: np.ndarray, known: np.ndarray, new: str, anchor: str) -> None:
    """Raise ContractError where (n, 2) shear shows that one sensor is turned by 180° or mirrored.

    A map would learn that, too, and the rig would still show the sensor the wrong way round.
    """
    relation = mount_relation(read, known)
    x, y = relation.r
    if relation.mount == "upright":
        return
    if relation.mount == "undecided":
        message = (
            "%s: shear agrees too little to tell how it is mounted (r %.2f along x, %.2f along y)"
        )
        logger.warning(message, new, x, y)
        return
    rotation_deg, flip = SETTINGS[relation.mount]
    setting = f"rotation_deg={rotation_deg} in the rig"
    if flip:
        setting = f"rotation_deg={rotation_deg} flip=true in the rig (a camera: its driver mirrors)"
    came = (
        f"the one {relation.mount} against the other (r of shear {x:.2f} along x, {y:.2f} along y)"
    )
    do = (
        f"`uniforce touch check=orientation` says which. If it is {new}: {setting}; "
        f"for pairs recorded without, mounted={relation.mount}."
    )
    raise ContractError(expected(f"mounts of {new} and {anchor}", "both upright", came, do))


def _split(
    classes: np.ndarray, grasps: np.ndarray, config: CalibrationConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows that judge, a share of each class's grasps, and rows to fit, shuffled."""
    order = np.random.default_rng(config.seed).permutation(len(classes))
    judges: list[int] = []
    for name in OBJECT_CLASSES:
        own = list(dict.fromkeys(grasps[order][classes[order] == name].tolist()))
        judges += own[: math.ceil(config.held_out * len(own))]
    is_judge = np.isin(grasps[order], judges)
    return order[is_judge], order[~is_judge]


def _r2(truth: np.ndarray, read: np.ndarray) -> tuple[float, float, float]:
    spread = np.maximum(((truth - truth.mean(axis=0)) ** 2).sum(axis=0), 1e-12)
    x, y, z = (1 - ((read - truth) ** 2).sum(axis=0) / spread).tolist()
    return x, y, z


def _abs_r(truth: np.ndarray, read: np.ndarray) -> tuple[float, float, float]:
    a = truth - truth.mean(axis=0)
    b = read - read.mean(axis=0)
    length = np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    x, y, z = np.abs((a * b).sum(axis=0) / np.maximum(length, 1e-12)).tolist()
    return x, y, z


def _check(
    z_new: torch.Tensor,
    z_anchor: torch.Tensor,
    classes: np.ndarray,
    grasps: np.ndarray,
    config: CalibrationConfig,
) -> None:
    """Raise ContractError where pairs aren't matched, finite, enough or loaded."""
    is_paired = len(classes) == len(grasps) == len(z_new)
    if z_new.shape != z_anchor.shape or z_new.ndim != 3 or not is_paired:
        shapes = f"{tuple(z_new.shape)}, {tuple(z_anchor.shape)}"
        came = f"{shapes}, {len(classes)} classes and {len(grasps)} grasps"
        wanted = "(n, P, latent) twice, n classes, n grasps"
        raise ContractError(expected("paired latents", wanted, came, "Pair them by frame."))
    unknown = sorted(set(classes.tolist()) - set(OBJECT_CLASSES))
    if unknown:
        wanted = " | ".join(OBJECT_CLASSES)
        raise ContractError(expected("class of an object", wanted, unknown, "Name it so."))
    for name in OBJECT_CLASSES:
        _check_count(name, grasps[classes == name], config.min_pairs // 2)
    if not bool(z_new.isfinite().all() and z_anchor.isfinite().all()):
        raise ContractError(
            expected("latents", "finite numbers", "NaN or inf", "Check the recordings.")
        )
    if float(z_anchor.mean(dim=1).std(dim=0).max()) < 1e-6:
        do = "Hold the object from outside and squeeze, push and twist it."
        raise ContractError(expected("grasps", "changing forces", "the same latent throughout", do))


def _check_count(name: str, grasps: np.ndarray, fewest: int) -> None:
    """Raise ContractError where one class has too few rows, or its rows (n,) too few grasps."""
    if len(grasps) < fewest:
        do = f"Grasp one class for a minute, then the other: {name} objects are missing."
        wanted = f"at least {fewest}"
        raise ContractError(expected(f"grasps of {name} objects", wanted, len(grasps), do))
    apart = len(np.unique(grasps))
    if apart < FEWEST_GRASPS:
        do = "Open the fingers between grasps, and grasp more often."
        wanted = f"at least {FEWEST_GRASPS}"
        raise ContractError(expected(f"separate grasps of {name} objects", wanted, apart, do))
