"""Draw what was covered: pairs over force, and over the pad, per indenter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_robots.pairs.coverage import NORMAL_EDGES_N, SHEAR_EDGES_N, Coverage
from uniforce_vtla.figure_file import save_figure


def draw_coverage(names: Sequence[str], coverage: Sequence[Coverage], path: Path) -> Path:
    """Write two rows of maps, a column per indenter: force above, place on the pad below."""
    figure = Figure(figsize=(1.9 * len(names) + 0.8, 4.6), layout="constrained")
    axes = figure.subplots(2, len(names), squeeze=False)
    for column, (name, covered) in enumerate(zip(names, coverage, strict=True)):
        _draw_force(axes[0][column], covered, name)
        _draw_place(axes[1][column], covered)
    axes[0][0].set_ylabel("normal force, N")
    axes[1][0].set_ylabel("place on the left pad")
    figure.suptitle("Kept pairs per cell; forces and places are estimates")
    return save_figure(figure, path)


def _draw_force(axis: Axes, covered: Coverage, name: str) -> None:
    axis.imshow(covered.force, origin="lower", cmap="Blues", aspect="auto")
    axis.set_title(f"{name}, {covered.force.sum()}", fontsize=9)
    axis.set_xticks(range(len(SHEAR_EDGES_N) - 1), [f"≤{edge:g}" for edge in SHEAR_EDGES_N[1:]], fontsize=7)
    axis.set_yticks(range(len(NORMAL_EDGES_N) - 1), [f"≤{edge:g}" for edge in NORMAL_EDGES_N[1:]], fontsize=7)
    axis.set_xlabel("shear, N", fontsize=7)
    _numbers(axis, covered.force)


def _draw_place(axis: Axes, covered: Coverage) -> None:
    axis.imshow(covered.place, cmap="Greens", aspect="equal")
    axis.set_xticks([])
    axis.set_yticks([])
    _numbers(axis, covered.place)


def _numbers(axis: Axes, counts: np.ndarray) -> None:
    dark = counts.max() / 2
    for row in range(counts.shape[0]):
        for column in range(counts.shape[1]):
            colour = "white" if counts[row, column] > dark else "black"
            axis.text(
                column, row, str(counts[row, column]), ha="center", va="center", fontsize=6, color=colour
            )
