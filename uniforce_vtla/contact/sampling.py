"""Random contacts: objects on the pad and loads within friction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.indenters import flat_face_gap, gap_maps

FLAT = "flat"  # name given to flat faces among the indenters
FLAT_SIDE_mm = (12.0, 40.0)  # shortest and longest side of a flat face: partly beyond the pad
HELD_SIDES_mm = (60.0, 40.0)  # of an eraser's side, along and across
HELD_TILT_rad = 0.005  # two parallel fingers square a tool up
FLAT_TILT_rad = 0.03  # a tool pressed by hand; what two parallel fingers hold lies flatter


@dataclass(frozen=True)
class ForceRange:
    """Bounds of sampled loads."""

    normal_N: float = 16.0  # beyond the expert's grip, so that over-pressing is known too
    shear_N: float = 8.0  # along either axis
    friction: float = 0.95  # shear over normal; just under the simulator's 1.0: rarely gross slip
    # torsion over friction × normal; a disc of radius 4 mm slips at 2/3 of that
    torsion_arm_mm: float = 2.5
    # the same of flat faces; even pressure over a 25 mm pad carries 9.6 mm
    flat_torsion_arm_mm: float = 2.5


PAPER_RANGE = ForceRange(normal_N=12.0, shear_N=3.0)  # the paper reports 0–12 N and ±3 N


@dataclass(frozen=True)
class Objects:
    """Objects on a pad: ``gap_mm`` (n, G, G) and their ``names``."""

    gap_mm: np.ndarray
    names: tuple[str, ...]


def sample_objects(
    rng: np.random.Generator,
    n: int,
    indenters: Sequence[str],
    flat_share: float = 0.0,
    flat_side_mm: tuple[float, float] = FLAT_SIDE_mm,
    flat_tilt_rad: float = FLAT_TILT_rad,
) -> Objects:
    """Return ``n`` random objects: places ±4 mm, any angle, sizes ±15 % or sides."""
    names = [str(indenters[i]) for i in rng.integers(len(indenters), size=n)]
    center = rng.uniform(-4, 4, (n, 2))
    angle = rng.uniform(-np.pi, np.pi, n)
    gap = gap_maps(names, center, angle, rng.uniform(0.85, 1.15, n))
    flat = np.flatnonzero(rng.random(n) < flat_share)
    gap[flat] = flat_face_gap(
        rng.uniform(-5, 5, (len(flat), 2)),
        rng.uniform(*flat_side_mm, (len(flat), 2)),
        rng.uniform(-0.3, 0.3, len(flat)),
        rng.uniform(-flat_tilt_rad, flat_tilt_rad, (len(flat), 2)),
    )
    for i in flat:
        names[i] = FLAT
    return Objects(gap, tuple(names))


def held_tools(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return (n, G, G) gaps of a tool's flat side held between parallel fingers."""
    center_mm = np.column_stack([rng.uniform(-3, 3, n), rng.uniform(-5, 5, n)])
    angle_rad = rng.uniform(-0.05, 0.05, n)
    tilt_rad = rng.uniform(-HELD_TILT_rad, HELD_TILT_rad, (n, 2))
    return flat_face_gap(center_mm, np.full((n, 2), HELD_SIDES_mm), angle_rad, tilt_rad)


def sample_loads(
    rng: np.random.Generator, n: int, force_range: ForceRange, names: Sequence[str] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return force (n, 3) N and torsion (n,) Nmm within friction; ``names`` mark flat faces.

    6 % no contact, 24 % light normal forces, the rest even. Shear is even over directions and its
    allowed range; half of the contacts have torsion.
    """
    kind = rng.random(n)
    fz = rng.uniform(0, force_range.normal_N, n)
    fz = np.where(kind < 0.3, rng.uniform(0, 0.15 * force_range.normal_N, n), fz)
    fz = np.where(kind < 0.06, 0, fz)
    direction = rng.uniform(-np.pi, np.pi, n)
    share = rng.random(n)
    unit = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    # the square ±shear_N, in every direction
    longest = force_range.shear_N / np.abs(unit).max(axis=1)
    shear = unit * (np.minimum(force_range.friction * fz, longest) * share)[:, None]
    used = np.hypot(*shear.T) / np.maximum(force_range.friction * fz, 1e-9)  # share of friction
    spare = np.sqrt(np.maximum(1 - used**2, 0))
    twist = np.where(rng.random(n) < 0.5, rng.uniform(-1, 1, n), 0)
    arm_mm = np.full(n, force_range.torsion_arm_mm)
    arm_mm[np.flatnonzero(np.array(names) == FLAT)] = force_range.flat_torsion_arm_mm
    torsion = twist * spare * force_range.friction * fz * arm_mm
    force = np.concatenate([shear, fz[:, None]], axis=1)
    return force.astype(np.float32), torsion.astype(np.float32)


def press_shear_release(
    rng: np.random.Generator, length: int, force_range: ForceRange
) -> np.ndarray:
    """Return (length, 3) float32 force: press in, shear out and back, release, with wobble.

    The four parts take random shares of the time. The peak normal force is even over the range, and
    so is the peak shear within friction.
    """
    corners = np.concatenate([[0], np.cumsum(rng.dirichlet(np.full(4, 4.0)))])  # 0 … 1
    time = np.linspace(0, 1, length)
    press = np.interp(time, corners, [0, 1, 1, 1, 0]) * rng.uniform(0.05, 1) * force_range.normal_N
    direction = rng.uniform(-np.pi, np.pi)
    unit = np.array([np.cos(direction), np.sin(direction)])
    most_N = min(force_range.shear_N / np.abs(unit).max(), force_range.friction * press.max())
    peak = most_N * rng.random()
    shear = np.interp(time, corners, [0, 0, 1, 0, 0])[:, None] * peak * unit
    wobble = 1 + 0.03 * rng.standard_normal(length)  # hand and robot never hold a force exactly
    fz = press * wobble
    room = np.minimum(1, force_range.friction * fz / np.maximum(np.hypot(*shear.T), 1e-9))
    return np.concatenate([shear * room[:, None], fz[:, None]], axis=1).astype(np.float32)
