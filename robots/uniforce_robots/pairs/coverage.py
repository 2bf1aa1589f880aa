"""What a session has covered so far, over force and over the place on the pad, and what is still missing.

Forces and places are estimates of the same readers that score the pairs: the map steers an operator, it labels nothing.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uniforce_robots.pairs.finger_force import CHANNELS, GRID
from uniforce_vtla.figure_file import save_figure

NORMAL_EDGES_N = (0.0, 2.0, 4.0, 6.0, 9.0, 12.0)  # the paper's range, finer where grasps are gentle
SHEAR_EDGES_N = (0.0, 0.5, 1.5, 3.0)  # magnitude
PLACE_CELLS = 4  # per side of the pad
ENOUGH = 10  # pairs in a cell that make it covered


def contact_place(field: np.ndarray) -> np.ndarray:
    """Return (N, 2) where the pad is pressed, x right and y down, −1 … 1 over the image.

    The centre of what moves against the pad's mean motion: shear moves all markers alike, pressing drives those around
    the contact apart and lets them grow. ``field`` holds (N, 192) touch fields, canonical.
    """
    maps = field.reshape(-1, CHANNELS, GRID * GRID)
    own = maps - np.median(maps, axis=2, keepdims=True)
    strength = (own**2).sum(axis=1)
    strength = np.maximum(strength - np.quantile(strength, 0.5, axis=1, keepdims=True), 0) + 1e-9
    share = strength / strength.sum(axis=1, keepdims=True)  # (N, cells)
    axis = (np.arange(GRID) + 0.5) / GRID * 2 - 1
    y, x = np.meshgrid(axis, axis, indexing="ij")
    return np.column_stack([share @ x.ravel(), share @ y.ravel()])


class Coverage:
    """Counts of kept pairs: ``force`` by (normal, shear), ``place`` by (row, column) over the pad; empty at first."""

    def __init__(self) -> None:
        self.force = np.zeros((len(NORMAL_EDGES_N) - 1, len(SHEAR_EDGES_N) - 1), int)
        self.place = np.zeros((PLACE_CELLS, PLACE_CELLS), int)

    def add(self, force_N: np.ndarray, place: np.ndarray) -> None:
        """Count pairs: (N, 3) forces and (N, 2) places; what lies beyond an edge counts in the last cell."""
        for force in force_N:
            self.force[self.cell(force)] += 1
        column, row = np.clip(((place + 1) / 2 * PLACE_CELLS).astype(int), 0, PLACE_CELLS - 1).T
        np.add.at(self.place, (row, column), 1)

    @staticmethod
    def cell(force_N: np.ndarray) -> tuple[int, int]:
        """Return (normal, shear) cell of a force (3,)."""
        pull = float(np.linalg.norm(force_N[:2]))
        return _bin(float(force_N[2]), NORMAL_EDGES_N), _bin(pull, SHEAR_EDGES_N)

    @property
    def covered(self) -> float:
        """Share of the force cells that hold ``ENOUGH`` pairs."""
        return float((self.force >= ENOUGH).mean())

    def missing(self) -> str:
        """Say in words which force cell holds least."""
        normal, shear = np.unravel_index(int(self.force.argmin()), self.force.shape)
        press = f"{NORMAL_EDGES_N[normal]:g}–{NORMAL_EDGES_N[normal + 1]:g} N"
        pull = f"{SHEAR_EDGES_N[shear]:g}–{SHEAR_EDGES_N[shear + 1]:g} N"
        return f"grip {press}, pull {pull}"


def _bin(value: float, edges: tuple[float, ...]) -> int:
    return int(np.clip(np.digitize(value, edges) - 1, 0, len(edges) - 2))


def draw_coverage(names: Sequence[str], coverage: Sequence[Coverage], path: Path) -> Path:
    """Write two rows of maps, a column per indenter: force above, place on the pad below."""
    figure = Figure(figsize=(1.9 * len(names) + 0.8, 4.6), layout="constrained")
    axes = figure.subplots(2, len(names), squeeze=False)
    for (force, place), name, covered in zip(axes.T, names, coverage, strict=True):
        force.imshow(covered.force, origin="lower", cmap="Blues", aspect="auto")
        force.set_title(f"{name}, {covered.force.sum()}", fontsize=9)
        for ticks, edges in ((force.set_xticks, SHEAR_EDGES_N), (force.set_yticks, NORMAL_EDGES_N)):
            ticks(range(len(edges) - 1), [f"≤{edge:g}" for edge in edges[1:]], fontsize=7)
        force.set_xlabel("shear, N", fontsize=7)
        place.imshow(covered.place, cmap="Greens", aspect="equal")
        place.set(xticks=[], yticks=[])
        for axis, counts in ((force, covered.force), (place, covered.place)):
            for (row, column), count in zip(np.ndindex(counts.shape), counts.flat, strict=True):
                colour = "white" if count > counts.max() / 2 else "black"
                axis.text(column, row, str(count), ha="center", va="center", fontsize=6, color=colour)
    axes[0][0].set_ylabel("normal force, N")
    axes[1][0].set_ylabel("place on the left pad")
    figure.suptitle("Kept pairs per cell; forces and places are estimates")
    return save_figure(figure, path)
