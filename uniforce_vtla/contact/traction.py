"""Shear load → tangential traction: the skin sticks to the object as far as friction allows."""

from dataclasses import dataclass
from typing import Self

import numpy as np

# marker motion is then within some 4 % of friction solved step by step; more don't come closer
_STICK_STEPS = 2
_LOST = 2e-3  # share of the normal force that sticking may lose of the load
_ARM_mm = 3.0  # at which a lost moment counts as a lost force
_TINY = np.float32(1e-30)
# rounds of handing capped cells' excess to sticking ones; the residual is < 1 % after 4
_PASSES = 6


@dataclass(frozen=True)
class Traction:
    """Traction of the object on the pad, on the cells that any contact of the batch presses."""

    cells: np.ndarray  # (K,) indices into the pad's cells
    press_N: np.ndarray  # (B, K) normal force on each
    shear_N: np.ndarray  # (B, 2, K) tangential force on each, x right, y down


@dataclass(frozen=True)
class CellSkin:
    """How far C cells move along the skin under forces on them, in mm per newton; x before y."""

    dragged: np.ndarray  # (2C, 2C) by forces along the skin; symmetric
    pushed: np.ndarray  # (2C, C) by forces into it

    @classmethod
    def of(cls, influence: np.ndarray, cells: np.ndarray) -> Self:
        """Return some (C,) cells of a pad's (3, P, 3, P) influence."""
        C = len(cells)
        part = influence[:2, cells][..., cells]  # (2, C, 3, C)
        dragged = part[:, :, :2].reshape(2 * C, 2 * C)
        return cls(dragged, pushed=part[:, :, 2].reshape(2 * C, C))


def solve_traction(
    press_N: np.ndarray,
    position_mm: np.ndarray,
    skin: CellSkin,
    shear_N: np.ndarray,
    torsion_Nmm: np.ndarray,
    friction: float,
) -> np.ndarray:
    """Return (B, 2, C) tangential forces on cells, in N, that carry shear and torsion.

    Every cell first gets q = p·(s + ω × r), r from the centre of pressure. Cells beyond |q| = μ·p
    slip: they keep μ·p, and the rest of the load goes to the others. Then forces that cancel in sum
    make the skin follow the rigid object. A load beyond friction is not reached.

    Args:
        press_N: (B, C) normal force on each cell.
        position_mm: (C, 2) cell centres.
        skin: of the same cells.
        shear_N: (B, 2) fx, fy.
        torsion_Nmm: (B,) moment about the centre of pressure, inward normal.
        friction: μ.
    """
    B, C = press_N.shape
    total = np.maximum(press_N.sum(axis=1, keepdims=True), 1e-9)
    arm = position_mm.T[None] - ((press_N @ position_mm) / total)[:, :, None]  # (B, 2, C)
    load = (shear_N, torsion_Nmm)
    # (B, 2, C) = q / p
    ratio = even = _cap(_share(press_N, arm, *load), press_N, arm, *load, friction)
    pushed = (press_N @ skin.pushed.T).reshape(B, 2, C)
    weight = press_N / total
    direction = np.zeros_like(ratio)
    old = np.ones(B, np.float32)
    for step in range(_STICK_STEPS):
        moved = ((ratio * press_N[:, None]).reshape(B, -1) @ skin.dragged).reshape(B, 2, C) + pushed
        slip = _less_rigid(moved, weight, arm)
        length = (slip**2 * press_N[:, None]).sum(axis=(1, 2))
        direction = (length / np.maximum(old, _TINY) * (step > 0))[:, None, None] * direction - slip
        change = ((direction * press_N[:, None]).reshape(B, -1) @ skin.dragged).reshape(B, 2, C)
        along = direction * press_N[:, None]
        curvature = np.maximum((change * along).sum(axis=(1, 2)), _TINY)
        size = -(slip * along).sum(axis=(1, 2)) / curvature
        ratio = _cap(ratio + size[:, None, None] * direction, press_N, arm, *load, friction)
        old = length
    # near gross slip, blend in a uniform load, just enough to balance
    shear = ratio * press_N[:, None]
    lost = np.hypot(*(even * press_N[:, None] - shear).sum(axis=2).T) / total[:, 0]
    lost = lost + np.abs(_moment((even - ratio) * press_N[:, None], arm)) / total[:, 0] / _ARM_mm
    back = np.maximum(1 - _LOST / np.maximum(lost, _LOST), 0)[:, None, None].astype(np.float32)
    return shear + back * (even * press_N[:, None] - shear)


def _less_rigid(moved: np.ndarray, weight: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return (B, 2, C) motion without the object's own shift and turn, as cells weigh."""
    moved = moved - (moved * weight[:, None]).sum(axis=2, keepdims=True)
    turn = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    inertia = np.maximum((weight * (arm**2).sum(axis=1)).sum(axis=1), 1e-9)
    angle = (weight[:, None] * moved * turn).sum(axis=(1, 2)) / inertia
    return moved - angle[:, None, None] * turn


def transmitted(
    press_N: np.ndarray, cell_shear_N: np.ndarray, position_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return force (B, 3) N and moment about the centre of pressure (B,) Nmm of a field."""
    centre = (press_N @ position_mm) / np.maximum(press_N.sum(axis=1, keepdims=True), 1e-9)
    arm = position_mm.T[None] - centre[:, :, None]
    force = np.concatenate([cell_shear_N.sum(axis=2), press_N.sum(axis=1, keepdims=True)], axis=1)
    return force, _moment(cell_shear_N, arm)


def _moment(q: np.ndarray, arm: np.ndarray) -> np.ndarray:
    return (arm[:, 0] * q[:, 1] - arm[:, 1] * q[:, 0]).sum(axis=1)


def _share(
    weight: np.ndarray, arm: np.ndarray, shear_N: np.ndarray, torsion_Nmm: np.ndarray
) -> np.ndarray:
    """Return (B, 2, C) traction per weight, s + ω × r, that carries the load."""
    total = weight.sum(axis=1)  # (B,)
    inertia = (weight * (arm**2).sum(axis=1)).sum(axis=1)
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
    """Return ``ratio`` with every cell's length ≤ friction; sticking cells take the excess."""
    for _ in range(_PASSES):
        length = np.sqrt((ratio**2).sum(axis=1))  # (B, C)
        if not np.any(length > friction * (1 + 1e-5)):
            break
        ratio = ratio * np.minimum(1, friction / np.maximum(length, 1e-9))[:, None]
        q = ratio * p[:, None]
        missing = shear_N - q.sum(axis=2)  # (B, 2)
        sticking = p * (length < friction)
        more = _share(sticking, arm, missing, torsion_Nmm - _moment(q, arm))
        ratio = ratio + more * (sticking > 0)[:, None]
    length = np.sqrt((ratio**2).sum(axis=1))
    return ratio * np.minimum(1, friction / np.maximum(length, 1e-9))[:, None]
