"""The zero-shot table as a picture: R² per row, axis and transfer, and the mean error in newtons beside it."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_vtla.figure_file import save_figure

AXES = ("Fx", "Fy", "Fz")
LOWEST = -1.0  # colours end here: an R² of −1000 only says "a constant offset"


def draw_table(content: dict[str, Any], path: Path) -> Path:
    """Draw ``content["rows"]``; transfers from a sensor to itself are left out."""
    rows = content["rows"]
    names = [name for name in next(iter(rows.values())) if len(set(name.split("->"))) == 2]
    figure = Figure(figsize=(16, 1.8 + 0.42 * len(rows)), layout="constrained")
    panels = figure.subplots(1, 4, sharey=True)
    for axis, panel in enumerate(panels[:3]):
        r2 = np.array([[cells[name]["r2"][axis] for name in names] for cells in rows.values()])
        _draw_r2(panel, r2, names, f"R² of {AXES[axis]}")
    error = np.array([[cells[name]["mae_N_paper_range"] for name in names] for cells in rows.values()])
    _draw_error(panels[3], error.mean(axis=1))
    panels[0].set_yticks(range(len(rows)), rows)
    figure.suptitle(f"Zero-shot force, simulated, unseen indenters ({content['set']})")
    return save_figure(figure, path)


def _draw_r2(panel: Axes, r2: np.ndarray, names: list[str], title: str) -> None:
    panel.imshow(np.maximum(r2, LOWEST), vmin=LOWEST, vmax=1, cmap="RdYlGn", aspect="auto")
    for (row, column), value in np.ndenumerate(r2):
        said = f"{value + 0.0:.2f}".replace("-0.00", "0.00") if value > -10 else "< −10"
        panel.text(column, row, said, ha="center", va="center", size=8, color="w" if value < -0.7 else "k")
    panel.set_xticks(range(len(names)), names)
    panel.set_title(title)


def _draw_error(panel: Axes, mae_N: np.ndarray) -> None:
    """Draw (rows, 3) errors as bars; the panel shares its rows with the others."""
    for axis, name in enumerate(AXES):
        panel.barh(np.arange(len(mae_N)) + 0.25 * (axis - 1), mae_N[:, axis], 0.25, label=name)
    panel.set_xscale("log")
    panel.set_title("mean absolute error, N (paper's range)")
    panel.legend(frameon=False)
