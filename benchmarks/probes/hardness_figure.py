"""Error in newtons by what was taken away from the hard set, with the floor nobody gets below."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.probes.zero_shot_figure import AXES
from uniforce_vtla.figure_file import save_figure


def draw_hardness(content: dict[str, Any], path: Path) -> Path:
    """Draw mean absolute errors of transfers and of sensors read by their own head."""
    names = list(content["without"])
    figure = Figure(figsize=(11, 4), layout="constrained")
    for axis, panel in enumerate(figure.subplots(1, 3)):
        for place, kind in enumerate(("transfers", "self")):
            mae_N = [content["without"][name][kind]["mae_N_paper_range"][axis] for name in names]
            panel.bar(np.arange(len(names)) + 0.4 * place - 0.2, mae_N, 0.4, label=kind)
        floor = content["oracle"]["mae_N_paper_range"][axis]
        panel.axhline(
            floor, color="black", linewidth=1, linestyle="--", label="oracle: gain and creep unknown"
        )
        panel.set_xticks(range(len(names)), names, rotation=40, ha="right")
        panel.set_title(f"{AXES[axis]}, N")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, ncols=3, loc="outside lower center")
    figure.suptitle("Mean absolute error (0–12, ±3 N), simulated, by what was taken away from hetero_hard_v1")
    return save_figure(figure, path)
