"""The grid of cells that carry contact, and where and how far back a sensor has skin on it.

Square cells, x right, y down, 0 at the pad's centre; the skin stands back from the tangent plane.
"""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.elastic import (
    Gel,
    Influence,
    cell_centres,
    cell_edges,
    influence,
    sagitta_mm,
)
from uniforce_vtla.errors import ContractError, expected

GRID_CELLS = 32
CELL_MM = 1.25
_LARGE_MM = 1e3  # stands in for "no object here" in sums, where inf would give NaN


def cell_positions_mm() -> np.ndarray:
    """Return (G·G, 2) cell centres (x, y) in mm, row by row from the top left."""
    axis = ((np.arange(GRID_CELLS) - (GRID_CELLS - 1) / 2) * CELL_MM).astype(np.float32)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class Pad:
    """The C cells of a sensor's skin, and how they give way."""

    position_mm: np.ndarray  # (C, 2) centres
    area_mm2: np.ndarray  # (C,) a cell at the pad's border may be cut
    block: np.ndarray  # (C, b·b) indices of the cells of the objects' grid that make up each
    dome_mm: np.ndarray  # (G·G,) how far the skin lies behind the tangent plane
    influence: Influence
    normal: np.ndarray  # (C, C) mm per newton: inward displacement of cells by pressure

    def total_gap_mm(self, gap_mm: np.ndarray) -> np.ndarray:
        """Return (B, C) distance from skin to object, given (B, G, G) gaps to the tangent plane.

        Raises ContractError: a gap map of another grid, or NaN in it.
        """
        is_grid = gap_mm.shape[1:] == (GRID_CELLS, GRID_CELLS)
        if not is_grid or np.isnan(gap_mm).any():
            came = "NaN" if is_grid else gap_mm.shape
            wanted = f"numbers or inf, (B, {GRID_CELLS}, {GRID_CELLS})"
            raise ContractError(expected("gap_mm", wanted, came, "Use contact.indenters."))
        near = (gap_mm.reshape(len(gap_mm), -1) + self.dome_mm)[:, self.block]  # (B, C, b·b)
        return np.minimum(near.min(axis=2), np.float32(_LARGE_MM)).astype(np.float32)


def has_object(total_gap_mm: np.ndarray) -> np.ndarray:
    """Return (B,) whether anything faces the pad."""
    return total_gap_mm.min(axis=1) < _LARGE_MM / 2


def build_pad(gel: Gel) -> Pad:
    """Return the pad of ``gel``; its finite elements are solved at first use."""
    x = cell_edges(gel.size_mm[0], gel.cell_mm)
    y = cell_edges(gel.size_mm[1], gel.cell_mm)
    centre = np.stack(cell_centres(x, y), axis=-1).reshape(-1, 2)
    area = (np.diff(y)[:, None] * np.diff(x)).ravel()
    dome = np.zeros(GRID_CELLS**2, dtype=np.float32)
    if gel.dome_radius_mm:
        inside = np.hypot(*centre.T) <= gel.size_mm[0] / 2
        centre = centre[inside]
        area = area[inside]
        dome = sagitta_mm(np.hypot(*cell_positions_mm().T), gel.dome_radius_mm).astype(np.float32)
    moved = influence(gel)
    normal = np.ascontiguousarray(moved.skin[2, :, 2])
    return Pad(
        centre.astype(np.float32),
        area.astype(np.float32),
        _blocks(centre, gel),
        dome,
        moved,
        normal,
    )


def _blocks(centre_mm: np.ndarray, gel: Gel) -> np.ndarray:
    """Return (C, b·b) indices into the objects' grid of the cells within each of the pad's."""
    side = max(1, round(gel.cell_mm / CELL_MM))
    corner = centre_mm / CELL_MM - (side - 1) / 2 + GRID_CELLS / 2
    first = np.clip(np.floor(corner), 0, GRID_CELLS - side)  # (C, 2) column, row
    step = np.arange(side)
    rows = first[:, 1, None, None] + step[:, None]
    columns = first[:, 0, None, None] + step
    return (rows * GRID_CELLS + columns).reshape(len(centre_mm), -1).astype(int)
