"""Normal load → pressure: the skin meets a rigid object without friction.

Conjugate gradients under p ≥ 0 and a given total (Polonsky and Keer, Wear 231, 1999), in batches.
"""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.pads import Pad, has_object
from uniforce_vtla.errors import ContractError, expected

# marker motion is then within .3 % of the limit's in the median contact, 2 % in the worst
_MAX_STEPS = 12
_TOLERANCE = 0.02  # share of the load that a step still moves from cell to cell: enough
_REACH_MM = 3.0  # cells this close to the first touch carry the load the iteration starts from
_LEAST_N = 1e-9  # smaller loads give way as this one does: squares of gaps over them leave float32
# mm per newton: softest distribution of pressure that is real; compliances' least is 7e-5
_FLATTEST = 1e-6
_TINY = np.float32(1e-30)


@dataclass(frozen=True)
class Pressure:
    """``press_N`` (B, C) on the pad's cells, ``depth_mm`` (B,) of the object since first touch."""

    press_N: np.ndarray
    depth_mm: np.ndarray


def solve_pressure(
    pad: Pad, gap_mm: np.ndarray, fz_N: np.ndarray, stiffness: float = 1.0
) -> Pressure:
    """Return the pressure under which a rigid object carries ``fz_N``.

    Args:
        pad: cells and their compliance.
        gap_mm: (B, G, G) gap to the tangent plane.
        fz_N: (B,) normal force.
        stiffness: factor on Young's modulus of all layers.

    Raises ContractError: force on a pad that faces no object.
    """
    gap = pad.total_gap_mm(gap_mm)  # (B, C)
    if np.any(~has_object(gap) & (fz_N > 0)):
        do = "Move it over the pad or set 0 N."
        raise ContractError(expected("contact", "an object over the pad", "none, with fz > 0", do))
    press = np.zeros_like(gap)
    depth = np.zeros(len(gap), np.float32)
    rows = np.flatnonzero(fz_N > 0)
    if len(rows):
        load = np.maximum(fz_N[rows], _LEAST_N).astype(np.float32)[:, None]
        # per load, and for a pad of nominal stiffness: the smallest loads then cost no precision
        gap = gap[rows]
        above = (gap - gap.min(axis=1, keepdims=True)) * (np.float32(stiffness) / load)
        near = (above * load < _REACH_MM * stiffness) * pad.area_mm2
        share, reached = share_load(pad.normal, above, near / near.sum(axis=1, keepdims=True))
        press[rows] = share * fz_N[rows, None]
        depth[rows] = reached * load[:, 0] / stiffness
    return Pressure(press, depth)


def share_load(
    compliance: np.ndarray, above: np.ndarray, share: np.ndarray, steps: int = _MAX_STEPS
) -> tuple[np.ndarray, np.ndarray]:
    """Return (B, C) shares ≥ 0 of each unit load and (B,) depth: displacement + gap in contact.

    Args:
        compliance: (C, C) symmetric.
        above: (B, C) gap counted from first touch, over the load.
        share: (B, C) to start from, rows of sum 1.
        steps: at most.
    """
    direction = np.zeros_like(share)
    old_length = np.ones(len(share), np.float32)
    carry = np.zeros(len(share))
    for _ in range(steps):
        touching = share > 0
        error = share @ compliance + above
        error -= _mean(error, touching)
        length = np.where(touching, error**2, 0).sum(axis=1)
        turn = (carry * length / np.maximum(old_length, _TINY)).astype(np.float32)
        direction = np.where(touching, error + turn[:, None] * direction, 0)
        change = direction @ compliance
        change -= _mean(change, touching)
        curvature = np.where(touching, change * direction, 0).sum(axis=1)
        # freeze converged items; their residual is only rounding noise
        moves = curvature > _FLATTEST * (direction**2).sum(axis=1)
        along = np.where(touching, error * direction, 0).sum(axis=1)
        size = np.where(moves, along / np.maximum(curvature, _TINY), 0).astype(np.float32)[:, None]
        stepped = np.maximum(share - size * direction, 0)
        sinks_in = (stepped == 0) & (error < 0)  # free cells that the object would pass through
        stepped = np.where(sinks_in, stepped - size * error, stepped)
        # a step beyond every cell: begin again where the object is deepest
        empty = ~stepped.any(axis=1)
        stepped[empty, error[empty].argmin(axis=1)] = 1
        stepped /= stepped.sum(axis=1, keepdims=True)
        moved = np.abs(stepped - share).sum(axis=1).max()
        share = stepped
        old_length = length
        carry = ~sinks_in.any(axis=1)
        if moved < _TOLERANCE:
            break
    return share, ((share @ compliance + above) * share).sum(axis=1)


def _mean(value: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return (B, 1) means over the cells that touch."""
    return (value * where).sum(axis=1, keepdims=True) / where.sum(axis=1, keepdims=True)
