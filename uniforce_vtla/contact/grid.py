"""The one pad grid every contact lives on: square cells, x right, y down, 0 at the pad's centre."""

from __future__ import annotations

import numpy as np

GRID_CELLS = 40  # cells per side: 1 mm cells cover the largest pad (TacTip, 40 mm)
CELL_MM = 1.0  # side of a cell; half the smallest marker pitch, finer buys nothing a marker shows
CELL_AREA_MM2 = CELL_MM**2


def cell_axis_mm() -> np.ndarray:
    """Return (G,) centre positions of the cells along either axis, in mm."""
    return ((np.arange(GRID_CELLS) - (GRID_CELLS - 1) / 2) * CELL_MM).astype(np.float32)


def cell_positions_mm() -> np.ndarray:
    """Return (G·G, 2) cell centres (x, y) in mm, row by row from the top left."""
    axis = cell_axis_mm()
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
