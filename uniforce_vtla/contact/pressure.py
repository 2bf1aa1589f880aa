"""Normal load → pressure: a Winkler foundation whose indentation is solved from the force."""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.pads import CELL_AREA_MM2, Pad, has_object
from uniforce_vtla.errors import ContractError, expected

_LEAST_LOAD_MM = 1e-30  # less counts as none: float32 loses precision at 1e-38
_MAX_STEPS = 40  # Newton on a convex piecewise-linear curve ends exactly; 40 is far beyond what occurs


@dataclass(frozen=True)
class Foundation:
    """A pad as a bed of springs."""

    pad: Pad  # where there is material
    stiffness: float  # N/mm³ under a full flat face
    rated_depth_mm: float  # depth that ``rated_force_N`` reaches there
    flat_footprint_mm2: float  # footprint of that face
    footprint_exponent: float  # see ``materials.PadMaterial``


@dataclass(frozen=True)
class Pressure:
    """Solved pressure: ``p_MPa`` (B, C) on the pad's cells, ``stiffness`` (B,) N/mm³, ``depth_mm`` (B,)."""

    p_MPa: np.ndarray
    stiffness: np.ndarray
    depth_mm: np.ndarray


def footprint_mm2(pad: Pad, total_gap_mm: np.ndarray, depth_mm: float) -> np.ndarray:
    """Return (B,) area of the object within ``depth_mm`` of first touch, nearer cells counting more."""
    above = total_gap_mm - total_gap_mm.min(axis=1, keepdims=True)
    near = np.maximum(1 - above / np.float32(depth_mm), 0)
    return near @ pad.coverage * CELL_AREA_MM2


def build_foundation(
    pad: Pad, rated_depth_mm: float, rated_force_N: float, footprint_exponent: float, scale: float = 1.0
) -> Foundation:
    """Return the foundation that reaches ``rated_depth_mm`` at ``rated_force_N`` under a full flat face."""
    overlap = np.maximum(rated_depth_mm - pad.dome_mm, 0)
    stiffness = rated_force_N / float(overlap @ pad.coverage * CELL_AREA_MM2) * scale
    flat = footprint_mm2(pad, pad.dome_mm[None], rated_depth_mm)
    return Foundation(pad, stiffness, rated_depth_mm, float(flat[0]), footprint_exponent)


def contact_stiffness(foundation: Foundation, area_mm2: np.ndarray) -> np.ndarray:
    """Return (B,) N/mm³ for objects of these footprints: smaller ones meet a stiffer bed."""
    ratio = foundation.flat_footprint_mm2 / np.maximum(area_mm2, 0.5 * CELL_AREA_MM2)
    return (foundation.stiffness * ratio**foundation.footprint_exponent).astype(np.float32)


def solve_pressure(foundation: Foundation, gap_mm: np.ndarray, fz_N: np.ndarray) -> Pressure:
    """Return the pressure under which p = k·max(δ − gap, 0) sums to ``fz_N``.

    Args:
        foundation: the pad's springs.
        gap_mm: (B, G, G) gap to the tangent plane.
        fz_N: (B,) normal force.

    Raises:
        ContractError: force on a pad that faces no object.
    """
    gap = foundation.pad.total_gap_mm(gap_mm)  # (B, C)
    if np.any(~has_object(gap) & (fz_N > 0)):
        do = "Move it over the pad or set 0 N."
        raise ContractError(expected("contact", "an object over the pad", "none, with fz > 0", do))
    area = footprint_mm2(foundation.pad, gap, foundation.rated_depth_mm)
    stiffness = contact_stiffness(foundation, area)
    # Counted from first touch: float32 then resolves the depth of the smallest load as finely as that of a large one.
    above = gap - gap.min(axis=1, keepdims=True)
    load = (fz_N / (stiffness * CELL_AREA_MM2)).astype(np.float32)  # (B,) sum of overlaps wanted, in mm
    load = np.where(load < _LEAST_LOAD_MM, np.float32(0), load)
    depth = _solve_depth(above, foundation.pad.coverage, load, load / np.maximum(area, CELL_AREA_MM2))
    overlap = np.maximum(depth[:, None] - above, 0) * foundation.pad.coverage
    p = _exact_sum(overlap * stiffness[:, None], fz_N / CELL_AREA_MM2)
    return Pressure(p, stiffness, depth)


def _solve_depth(above: np.ndarray, coverage: np.ndarray, load: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return (B,) depth δ with Σ coverage·max(δ − above, 0) = load; 0 where the load is 0.

    Newton: the sum is convex and piecewise linear in δ, so after the first step it only falls, and ends exactly.
    """
    least = load / coverage.sum()  # the whole pad under a flat face; rounding must not end below it
    depth = guess + np.float32(1e-4)
    for _ in range(_MAX_STEPS):
        over = depth[:, None] - above
        touching = (over > 0) * coverage  # (B, C)
        area = np.maximum(touching.sum(axis=1), np.float32(1e-6))
        step = (np.einsum("bc,bc->b", touching, over) - load) / area
        depth = np.maximum(depth - step, least)
        if np.all(np.abs(step) <= 1e-5 * depth):
            break
    return np.where(load > 0, depth, np.float32(0))


def _exact_sum(p: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Scale (B, C) so that each row sums to ``total``: removes what float32 left over."""
    sums = p.sum(axis=1)
    return p * (total / np.maximum(sums, np.float32(1e-12))).astype(np.float32)[:, None]
