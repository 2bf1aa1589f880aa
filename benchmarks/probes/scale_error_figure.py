"""Force over how wrong a new camera's px/mm was stated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.probes.zero_shot_figure import AXES
from uniforce_vtla.figure_file import save_figure


def draw_scale_error(content: dict[str, Any], path: Path) -> Path:
    """Draw R² of each axis over the stated scale, a line per sensor; return the picture's path."""
    stated = np.array(content["stated_over_true"])
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    for axis, panel in enumerate(figure.subplots(1, 3, sharey=True)):
        for sensor, r2 in content["r2"].items():
            panel.plot(stated, np.array(r2)[:, axis], "o-", ms=4, label=sensor)
        panel.axvline(1.0, color="0.5", lw=0.8, ls="--")
        panel.set(title=AXES[axis], xlabel="px/mm as stated over true", ylim=(-0.6, 1.02))
        panel.grid(alpha=0.25)
    figure.axes[0].set_ylabel("R², mean over sources")
    figure.axes[0].legend(fontsize=8)
    figure.suptitle(f"Cameras nobody trained on, their scale misstated ({content['set']}, simulated)")
    return save_figure(figure, path)
