"""The zero-shot table as a picture: R² per axis and transfer, one colour per row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

AXES = ("Fx", "Fy", "Fz")
LOWEST = -1.0  # bars below are cut: an R² of −1000 only says "a constant offset"


def draw_table(content: dict[str, Any], path: Path) -> Path:
    """Draw ``content["rows"]``; transfers from a sensor to itself are left out."""
    rows = content["rows"]
    names = [name for name in rows["mean"]]
    figure = Figure(figsize=(11, 7))
    for axis, axes in enumerate(figure.subplots(3, 1, sharex=True)):
        for place, (row, cells) in enumerate(rows.items()):
            height = np.array([cells[name]["r2"][axis] for name in names])
            x = np.arange(len(names)) + (place - (len(rows) - 1) / 2) * 0.2
            axes.bar(x, np.maximum(height, LOWEST), 0.2, label=row)
        axes.axhline(0, color="black", linewidth=0.5)
        axes.set_ylim(LOWEST, 1)
        axes.set_ylabel(f"R² of {AXES[axis]}")
        axes.set_xticks(range(len(names)), names)
    figure.axes[0].set_title(
        f"Zero-shot force, simulated, unseen indenters ({content['set']}); cut at {LOWEST}"
    )
    figure.axes[0].legend(frameon=False, ncols=4, loc="lower left")
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100, bbox_inches="tight")
    return path
