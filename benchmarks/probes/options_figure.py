"""What the tokenizer's accuracy depends on: one option changed at a time, worst shear cell first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from uniforce_vtla.figure_file import save_figure

LOWEST = -1.0  # R² is drawn down to here; a number says what lies below
PANELS = {
    "worst shear R²": "shear_worst",
    "mean shear R²": "shear_mean",
    "mean Fz R²": "fz_mean",
    "mean Fz error, N": "mae_fz_N",
}


def draw_options(content: dict[str, Any], path: Path) -> Path:
    """Draw the options of ``tokenizer_options``, the best worst-shear cell on top; return the picture."""
    options = content["options"]
    names = sorted(options, key=lambda name: options[name]["summary"]["shear_worst"])
    figure = Figure(figsize=(13, 1.4 + 0.3 * len(names)), layout="constrained")
    panels = figure.subplots(1, len(PANELS), sharey=True)
    first = next(iter(options))  # the recipe the others differ from
    colours = ["#1f6fb2" if name == first else "0.65" for name in names]
    for panel, (title, key) in zip(panels, PANELS.items(), strict=True):
        values = np.array([options[name]["summary"][key] for name in names])
        shown = np.maximum(values, LOWEST)
        panel.barh(range(len(names)), shown, color=colours)
        for row, value in enumerate(values):
            panel.text(max(shown[row], 0) + 0.02, row, f"{value:.2f}", va="center", fontsize=7)
        panel.axvline(values[names.index(first)], color="#1f6fb2", lw=0.8, ls="--")
        panel.set_title(title)
        panel.margins(x=0.15)
    panels[0].set_yticks(range(len(names)), names)
    figure.suptitle(
        f"nano recipe, {content['steps']} steps, one option changed at a time ({content['set']}, simulated)"
    )
    return save_figure(figure, path)
