"""Q1 as a picture: r of six latents with three forces per sensor, before and after the one rotation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from uniforce_vtla.figure_file import save_figure

FORCES = ("Fx", "Fy", "Fz")


def draw_correlations(content: dict[str, Any], path: Path) -> Path:
    """Draw what ``latent_correlation`` returned; a frame marks the axis that stands for a force."""
    sensors = list(content["after"]["sensors"])
    figure = Figure(figsize=(2.6 * len(sensors) + 1.5, 7.5), layout="constrained")
    grid = figure.subplots(2, len(sensors), squeeze=False, sharey="row")
    for row, (side, letter) in enumerate((("before", "z"), ("after", "y"))):
        for column, sensor in enumerate(sensors):
            found = content[side]["sensors"][sensor]
            axes = grid[row, column]
            image = _heatmap(axes, found, content[side]["axes"])
            axes.set_yticks(range(len(found["r"])), [f"{letter}{i}" for i in range(len(found["r"]))])
            axes.set_title(f"{sensor}, {side} rotation\nn = {found['frames']}", fontsize=9)
    figure.colorbar(image, ax=grid, label="Pearson r, mean over indenters (± SD)", shrink=0.6)
    figure.suptitle(f"Latent and force, simulated, unseen indenters; rotation fitted on {content['source']}")
    return save_figure(figure, path, dpi=100)


def _heatmap(axes: Axes, found: dict[str, Any], chosen: list[int]) -> Any:
    mean = np.array(found["mean"])  # (L, 3)
    sd = np.zeros_like(mean) if found["sd"] is None else np.array(found["sd"])
    image = axes.imshow(mean, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    for (latent, force), value in np.ndenumerate(mean):
        colour = "white" if abs(value) > 0.6 else "black"
        text = f"{value:.2f}\n±{sd[latent, force]:.2f}"
        axes.text(force, latent, text, ha="center", va="center", color=colour, fontsize=7)
    for force, latent in enumerate(chosen):
        axes.add_patch(Rectangle((force - 0.5, latent - 0.5), 1, 1, fill=False, linewidth=2))
    axes.set_xticks(range(3), FORCES)
    return image
