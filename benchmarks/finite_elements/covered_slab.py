"""A gel slab under a flat rigid plate that covers it: quadratic finite elements of one quarter.

The back is bonded. A wall is free, or can't move outwards. The gel slides on the plate without
friction, or sticks to it. All is linear in the load, so displacements are per newton.
Axes are the image's: x right, y down, z into the gel.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from skfem import Basis, ElementHex2, ElementVector, MeshHex, condense, solve
from skfem.models.elasticity import lame_parameters, linear_elasticity

Face = Literal["sliding", "sticking"]
_QUADRATURE_ORDER = 5  # three points along each axis
_GRADING = 0.7  # power below 1: elements shrink towards wall and faces
_TINY_MM = 1e-9


@dataclass(frozen=True)
class Slab:
    """A block of one material, ``size_mm`` (x, y)."""

    size_mm: tuple[float, float]
    thickness_mm: float
    young_MPa: float
    poisson: float

    @property
    def uniaxial_stiffness(self) -> float:
        """Stiffness in N/mm under a plate where no wall moves, in closed form."""
        poisson = self.poisson
        modulus_MPa = self.young_MPa * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
        return modulus_MPa * self.size_mm[0] * self.size_mm[1] / self.thickness_mm


class PressedSlab:
    """The slab under a plate that carries 1 N: ``stiffness_N_per_mm`` and where its points go."""

    def __init__(
        self,
        slab: Slab,
        face: Face,
        free_walls: tuple[bool, bool],
        elements: tuple[int, int] = (6, 4),
    ) -> None:
        """Take which walls are free (across x, across y), and elements along half a side and in depth.

        The elements in depth are an even number.
        """
        sides_mm = [_edges(side / 2, elements[0]) for side in slab.size_mm]
        half_mm = _edges(slab.thickness_mm / 2, elements[1] // 2)
        depth_mm = slab.thickness_mm / 2 + np.concatenate([-half_mm[:0:-1], half_mm])
        self._basis = Basis(
            MeshHex.init_tensor(*sides_mm, depth_mm),
            ElementVector(ElementHex2()),
            intorder=_QUADRATURE_ORDER,
        )
        lame_MPa = lame_parameters(slab.young_MPa, slab.poisson)
        stiffness = linear_elasticity(*lame_MPa).assemble(self._basis)
        x_mm = self._basis.doflocs  # (3, N)
        axis = self._axis_of_dofs()
        plate = x_mm[2] < _TINY_MM
        held = x_mm[2] > slab.thickness_mm - _TINY_MM  # the bonded back
        held |= plate & ((axis == 2) | (face == "sticking"))
        for k, free in enumerate(free_walls):
            middle = x_mm[k] < _TINY_MM
            wall = x_mm[k] > slab.size_mm[k] / 2 - _TINY_MM
            held |= (axis == k) & (middle | (wall & (not free)))
        pushed = (plate & (axis == 2)).astype(float)  # the plate moves 1 mm
        moved = solve(*condense(stiffness, x=pushed, D=np.flatnonzero(held)))
        self.stiffness_N_per_mm = 4 * float(pushed @ (stiffness @ moved))
        self._moved = moved / self.stiffness_N_per_mm

    def _axis_of_dofs(self) -> np.ndarray:
        """Return (N,) which component of the displacement each degree of freedom is."""
        axis = np.empty(self._basis.N, int)
        for table in (
            self._basis.nodal_dofs,
            self._basis.edge_dofs,
            self._basis.facet_dofs,
            self._basis.interior_dofs,
        ):
            axis[table] = np.arange(3)[:, None]
        return axis

    def motion(self, point_mm: np.ndarray, depth_mm: float) -> np.ndarray:
        """Return (M, 3) displacement in mm per newton of (M, 2) points at one depth below the plate."""
        depth = np.full(len(point_mm), depth_mm)
        place_mm = np.vstack([np.abs(point_mm).T, depth])  # (3, M) in the meshed quarter
        moved = (self._basis.probes(place_mm) @ self._moved).reshape(3, -1).T  # (M, 3)
        moved[:, :2] *= np.sign(point_mm)
        return np.asarray(moved)


def _edges(half_mm: float, elements: int) -> np.ndarray:
    """Return the borders of elements from the middle outwards."""
    return half_mm * np.linspace(0, 1, elements + 1) ** _GRADING
