"""Estimated against true error, and precision and recall over the threshold."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.pairs.evaluation import ScoredPairs
from uniforce_robots.pairs.rehearsal import LIMIT
from uniforce_vtla.figure_file import save_figure

FLOOR = 0.003  # errors are drawn on a logarithmic axis
COLOURS = {
    "none": "0.6", "jerked": "tab:orange", "free": "tab:green", "slipping": "tab:purple", "one_finger": "tab:red",
    "pushed": "tab:blue",
}  # fmt: skip


def draw_scores(scored: Sequence[ScoredPairs], content: dict[str, Any], path: Path) -> Path:
    """Write the figure."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_errors(left, scored, content["settings"]["limit"])
    _draw_thresholds(right, content)
    figure.suptitle("Pair quality against the simulator's truth, sessions the score was not tuned on")
    return save_figure(figure, path)


def _draw_errors(axis: Axes, scored: Sequence[ScoredPairs], limit: float) -> None:
    fault = np.concatenate([s.fault for s in scored])
    error = np.maximum(np.concatenate([s.error for s in scored]), FLOOR)
    estimated = np.maximum(np.concatenate([s.estimated for s in scored]), FLOOR)
    for name, colour in COLOURS.items():
        here = fault == name
        axis.plot(error[here], estimated[here], ".", color=colour, markersize=2, label=name)
    axis.axvline(LIMIT, color="black", linewidth=0.8)
    axis.axhline(limit, color="black", linewidth=0.8, linestyle="--")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("true equilibrium error")
    axis.set_ylabel("estimated")
    axis.legend(markerscale=5, fontsize=8, title="what went wrong in the grasp", title_fontsize=8)


def _draw_thresholds(axis: Axes, content: dict[str, Any]) -> None:
    limits = [float(limit) for limit in content["by_threshold"]]
    for key in ("precision", "recall"):
        axis.plot(limits, [row[key] for row in content["by_threshold"].values()], "o-", label=key)
    axis.axhline(content["bar"], color="black", linewidth=0.8, linestyle="--", label="bar")
    axis.axvline(content["settings"]["limit"], color="0.7", linewidth=0.8)
    axis.set_ylim(0.7, 1.005)
    axis.set_xlabel("threshold on the estimated error")
    axis.set_title("without leaning along the closing axis", fontsize=9)
    axis.legend(fontsize=8)
