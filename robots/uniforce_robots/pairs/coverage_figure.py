"""Draw what was covered: pairs over force, and over the pad, per indenter."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uniforce_robots.pairs.coverage import NORMAL_EDGES_N, SHEAR_EDGES_N, Coverage
from uniforce_vtla.figure_file import save_figure


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
