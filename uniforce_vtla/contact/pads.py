"""The pad grid every contact lives on, where a sensor has material on it, and how far its skin stands back.

Square cells, x right, y down, 0 at the pad's centre; the skin stands back from the tangent plane.
"""

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.sensors import SensorSpec

GRID_CELLS = 40  # cells per side: 1 mm cells cover the largest pad (TacTip, 40 mm)
CELL_MM = 1.0  # side of a cell; half the smallest marker pitch, finer buys nothing a marker shows
CELL_AREA_MM2 = CELL_MM**2
_LARGE_MM = 1e3  # stands in for "no object here" in sums, where inf would give NaN


def cell_positions_mm() -> np.ndarray:
    """Return (G·G, 2) cell centres (x, y) in mm, row by row from the top left."""
    axis = ((np.arange(GRID_CELLS) - (GRID_CELLS - 1) / 2) * CELL_MM).astype(np.float32)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class Pad:
    """A sensor's cells."""

    cells: np.ndarray  # (C,) indices into the flattened grid of the cells with material
    position_mm: np.ndarray  # (C, 2) their centres
    coverage: np.ndarray  # (C,) share of each cell that is material, 0–1
    dome_mm: np.ndarray  # (C,) how far the skin lies behind the tangent plane

    def total_gap_mm(self, gap_mm: np.ndarray) -> np.ndarray:
        """Return (B, C) distance from skin to object, given (B, G, G) gaps to the tangent plane.

        Raises:
            ContractError: a gap map of another grid, or NaN in it.
        """
        if gap_mm.shape[1:] != (GRID_CELLS, GRID_CELLS) or np.isnan(gap_mm).any():
            came = "NaN" if gap_mm.shape[1:] == (GRID_CELLS, GRID_CELLS) else gap_mm.shape
            wanted = f"numbers or inf, (B, {GRID_CELLS}, {GRID_CELLS})"
            raise ContractError(expected("gap_mm", wanted, came, "Use contact.indenters."))
        flat = gap_mm.reshape(len(gap_mm), -1)[:, self.cells]  # (B, C)
        return np.minimum(flat + self.dome_mm, np.float32(_LARGE_MM)).astype(np.float32)


def has_object(total_gap_mm: np.ndarray) -> np.ndarray:
    """Return (B,) whether anything faces the pad."""
    return total_gap_mm.min(axis=1) < _LARGE_MM / 2


def build_pad(spec: SensorSpec) -> Pad:
    """Return the pad of ``spec`` on the common grid."""
    position = cell_positions_mm()
    half = np.asarray(spec.pad_size_mm, dtype=np.float32) / 2
    if spec.dome_radius_mm is None:
        inside = np.clip((half - np.abs(position)) / CELL_MM + 0.5, 0, 1).prod(axis=1)
        dome = np.zeros(len(position), dtype=np.float32)
    else:
        radius = np.hypot(*position.T)
        inside = np.clip((half[0] - radius) / CELL_MM + 0.5, 0, 1)
        dome = spec.dome_radius_mm - np.sqrt(np.maximum(spec.dome_radius_mm**2 - radius**2, 0))
    cells = np.flatnonzero(inside > 0)
    return Pad(cells, position[cells], inside[cells].astype(np.float32), dome[cells].astype(np.float32))
