"""Shear load → tangential traction: shared in proportion to pressure, capped by friction."""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.pads import CELL_AREA_MM2

_PASSES = 6  # rounds of handing capped cells' excess to sticking ones; the residual is < 1 % after 4


@dataclass(frozen=True)
class Traction:
    """What the object does to the pad, on the cells any contact of the batch presses."""

    cells: np.ndarray  # (K,) indices into the pad's cells
    p_MPa: np.ndarray  # (B, K) pressure
    q_MPa: np.ndarray  # (B, 2, K) shear traction, x right, y down
    indentation_mm: np.ndarray  # (B, K) inward displacement under the object


def solve_traction(
    p_MPa: np.ndarray,
    position_mm: np.ndarray,
    shear_N: np.ndarray,
    torsion_Nmm: np.ndarray,
    friction: float,
) -> np.ndarray:
    """Return (B, 2, C) tangential traction in MPa that carries shear and torsion.

    Every cell gets q = p·(s + ω × r), r from the centre of pressure. Cells beyond |q| = μ·p slip: they keep
    μ·p, and the rest of the load is offered to the others. A load beyond friction is not reached.

    Args:
        p_MPa: (B, C) pressure.
        position_mm: (C, 2) cell centres.
        shear_N: (B, 2) fx, fy.
        torsion_Nmm: (B,) moment about the centre of pressure, inward normal.
        friction: μ.
    """
    centre = (p_MPa @ position_mm) / np.maximum(p_MPa.sum(axis=1, keepdims=True), 1e-9)  # (B, 2)
    arm = position_mm.T[None] - centre[:, :, None]  # (B, 2, C)
    ratio = _share(p_MPa, arm, shear_N, torsion_Nmm)  # (B, 2, C) = q / p
    return _cap(ratio, p_MPa, arm, shear_N, torsion_Nmm, friction) * p_MPa[:, None]


def transmitted(p_MPa: np.ndarray, q_MPa: np.ndarray, position_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the force (B, 3) in N and the moment about the centre of pressure (B,) in Nmm carried by a field."""
    centre = (p_MPa @ position_mm) / np.maximum(p_MPa.sum(axis=1, keepdims=True), 1e-9)
    arm = position_mm.T[None] - centre[:, :, None]
    force = np.concatenate([q_MPa.sum(axis=2), p_MPa.sum(axis=1, keepdims=True)], axis=1)
    return force * CELL_AREA_MM2, _moment(q_MPa, arm)


def _moment(q: np.ndarray, arm: np.ndarray) -> np.ndarray:
    return (arm[:, 0] * q[:, 1] - arm[:, 1] * q[:, 0]).sum(axis=1) * CELL_AREA_MM2


def _share(weight: np.ndarray, arm: np.ndarray, shear_N: np.ndarray, torsion_Nmm: np.ndarray) -> np.ndarray:
    """Return (B, 2, C) traction per weight, s + ω × r, that carries the load."""
    total = weight.sum(axis=1) * CELL_AREA_MM2  # (B,)
    inertia = (weight * (arm**2).sum(axis=1)).sum(axis=1) * CELL_AREA_MM2
    s = shear_N / np.maximum(total, 1e-9)[:, None] * (total > 1e-9)[:, None]
    omega = torsion_Nmm / np.maximum(inertia, 1e-9) * (inertia > 1e-9)
    turn = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    return (s[:, :, None] + omega[:, None, None] * turn).astype(np.float32)


def _cap(
    ratio: np.ndarray,
    p: np.ndarray,
    arm: np.ndarray,
    shear_N: np.ndarray,
    torsion_Nmm: np.ndarray,
    friction: float,
) -> np.ndarray:
    """Return ``ratio`` with every cell's length ≤ friction, the excess handed to cells that still stick."""
    for _ in range(_PASSES):
        length = np.sqrt((ratio**2).sum(axis=1))  # (B, C)
        if not np.any(length > friction * (1 + 1e-5)):
            break
        ratio = ratio * np.minimum(1, friction / np.maximum(length, 1e-9))[:, None]
        q = ratio * p[:, None]
        missing = shear_N - q.sum(axis=2) * CELL_AREA_MM2  # (B, 2)
        sticking = p * (length < friction)
        ratio = ratio + _share(sticking, arm, missing, torsion_Nmm - _moment(q, arm)) * (sticking > 0)[:, None]
    length = np.sqrt((ratio**2).sum(axis=1))
    return ratio * np.minimum(1, friction / np.maximum(length, 1e-9))[:, None]
