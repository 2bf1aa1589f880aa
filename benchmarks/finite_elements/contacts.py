"""Contacts solved with friction on a finer mesh than the simulator's, to check it by."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.finite_elements.friction import CellForces, FrictionContact, Motion
from benchmarks.finite_elements.theory import cell_centres_mm
from uniforce_vtla.contact.elastic import Gel, influence, sagitta_mm
from uniforce_vtla.contact.indenters import HEIGHTS, flat_gap, indenter_gap
from uniforce_vtla.contact.pads import cell_positions_mm
from uniforce_vtla.contact.pressure import share_load
from uniforce_vtla.contact.sampling import FLAT, FLAT_SIDE_mm, FLAT_TILT_rad
from uniforce_vtla.contact.virtual import VirtualSensor, gel_of

CELL_MM = {"gelsight": 0.8, "tactip": 1.25, "uskin": 0.95}  # about two thirds of the simulator's
PRESS_STEPS = 5
SLIDE_STEPS = 3


@dataclass(frozen=True)
class Contact:
    """One object on one pad, followed from first touch to a sheared press."""

    name: str  # of the indenter, or "flat"
    gap_mm: np.ndarray  # (G, G) on the simulator's grid of objects
    depth_mm: np.ndarray  # (T,)
    force_N: np.ndarray  # (T, 3)
    torsion_Nmm: np.ndarray  # (T,) about the centre of pressure
    cells: tuple[CellForces, ...]  # (T,) on the fine mesh


@dataclass(frozen=True)
class _Object:
    """A shape that can be asked for its gap anywhere on the pad."""

    name: str
    center_mm: np.ndarray
    angle_rad: np.ndarray
    size: np.ndarray  # scale of an indenter, (1, 2) extent of a flat face
    tilt_rad: np.ndarray

    def gap_mm(self, position_mm: np.ndarray) -> np.ndarray:
        center = self.center_mm
        angle = self.angle_rad
        if self.name == FLAT:
            return flat_gap(center, self.size, angle, self.tilt_rad, position_mm)[0]
        return indenter_gap([self.name], center, angle, self.size, position_mm)[0]


def fine_gel(sensor: VirtualSensor) -> Gel:
    """Return the sensor's body on the finer mesh."""
    return gel_of(sensor.spec, replace(sensor.material, cell_mm=CELL_MM[sensor.like]))


def solve_contacts(
    rng: np.random.Generator,
    sensor: VirtualSensor,
    n: int,
    flat_share: float = 0.3,
    friction: float = 1.0,
) -> list[Contact]:
    """Return ``n`` contacts of all indenters and held flat tools, 1 to 14 N, sheared up to slip."""
    gel = fine_gel(sensor)
    position = cell_centres_mm(gel)
    dome = np.zeros(len(position))
    if gel.dome_radius_mm:
        dome = sagitta_mm(np.hypot(*position.T), gel.dome_radius_mm)
    skin = influence(gel).skin / sensor.material.stiffness
    solver = FrictionContact(skin, position, friction)
    normal = skin[2, :, 2]
    found = []
    for _ in range(n):
        found.append(_solved(rng, _drawn(rng, flat_share), solver, normal, position, dome))
    return found


def _drawn(rng: np.random.Generator, flat_share: float) -> _Object:
    if rng.random() < flat_share:
        center = rng.uniform(-5, 5, (1, 2))
        size = rng.uniform(*FLAT_SIDE_mm, (1, 2))
        tilt = rng.uniform(-FLAT_TILT_rad, FLAT_TILT_rad, (1, 2))
        return _Object(FLAT, center, rng.uniform(-0.3, 0.3, 1), size, tilt)
    name = str(rng.choice(list(HEIGHTS)))
    center = rng.uniform(-4, 4, (1, 2))
    angle = rng.uniform(-np.pi, np.pi, 1)
    return _Object(name, center, angle, rng.uniform(0.85, 1.15, 1), np.zeros((1, 2)))


def _solved(
    rng: np.random.Generator,
    shape: _Object,
    solver: FrictionContact,
    normal: np.ndarray,
    position_mm: np.ndarray,
    dome_mm: np.ndarray,
) -> Contact:
    gap = shape.gap_mm(position_mm) + dome_mm
    gap = gap - gap.min()
    depth = _depth_of(rng.uniform(1, 14), gap, normal)
    # up to three times the slide at which a patch slips as a whole: friction's share of the depth
    length = rng.uniform(0, 1.0) * depth
    way = rng.uniform(-np.pi, np.pi)
    slide = length * np.array([np.cos(way), np.sin(way)])
    turn = rng.uniform(-0.1, 0.1) * (rng.random() < 0.5)
    path = [Motion(float(depth * s)) for s in np.linspace(0.2, 1, PRESS_STEPS)]
    for s in np.linspace(0, 1, SLIDE_STEPS + 1)[1:]:
        path.append(
            Motion(float(depth), (float(slide[0] * s), float(slide[1] * s)), float(turn * s))
        )
    cells = tuple(solver.follow(gap, path))
    totals = np.array([_total(one, position_mm) for one in cells], np.float32)  # (T, 4)
    map_mm = shape.gap_mm(cell_positions_mm())
    side = round(np.sqrt(len(map_mm)))
    return Contact(
        shape.name,
        map_mm.reshape(side, side).astype(np.float32),
        np.array([m.depth_mm for m in path]),
        totals[:, :3],
        totals[:, 3],
        cells,
    )


def _depth_of(fz_N: float, gap_mm: np.ndarray, normal: np.ndarray) -> float:
    """Return the depth at which an object without friction carries ``fz_N``."""
    near = (gap_mm < 3)[None].astype(np.float32)
    gap = np.minimum(gap_mm, 1e3)[None].astype(np.float32) / np.float32(fz_N)
    return fz_N * float(share_load(normal, gap, near / near.sum(), steps=60)[1][0])


def _total(cells: CellForces, position_mm: np.ndarray) -> list[float]:
    """Return fx, fy, fz and the moment about the centre of pressure."""
    press = cells.press_N.sum()
    arm = position_mm - (cells.press_N @ position_mm) / max(press, 1e-9)
    moment = (arm[:, 0] * cells.shear_N[1] - arm[:, 1] * cells.shear_N[0]).sum()
    return [*cells.shear_N.sum(axis=1), press, moment]
