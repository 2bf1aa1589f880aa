"""Real grasps as a picture: normal load of both fingers, slip scores over time, and AUROC beside its controls."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.probes.latent_rotation import Rotation
from benchmarks.probes.real_slip import loads
from benchmarks.probes.real_trials import RATE_HZ, Signals, Trial
from uniforce_vtla.figure_file import save_figure

NORMAL = 2  # third component of ``loads``
SHOWN = ("latent", "raw counts")  # scores drawn over time


def draw_real_slip(
    report: dict[str, Any],
    trials: Sequence[Trial],
    signals: Sequence[Signals],
    scores: Mapping[str, Sequence[np.ndarray]],
    rotation: Rotation,
    path: Path,
) -> Path:
    """Draw what ``real_slip`` returned: a column per trial whose load changes, then all AUROCs.

    Grey = labelled slip, hatched = dropped.  A diamond is one trial's own AUROC.
    """
    shown = [number for number, t in enumerate(trials) if t.name in report["balance"]["trials"]]
    figure = Figure(figsize=(3.4 * len(shown), 10), layout="constrained")
    place = figure.add_gridspec(4, len(shown))
    grid = np.array([[figure.add_subplot(place[row, c]) for c in range(len(shown))] for row in range(3)])
    for column, number in enumerate(shown):
        trial = trials[number]
        _column(grid[:, column], trial, loads(signals[number], rotation))
        for name in SHOWN:
            grid[2, column].plot(_seconds(trial), scores[name][number], linewidth=0.8, label=name)
        own = "" if trial.reference_from == "own" else "\nborrowed reference"
        grid[0, column].set_title(trial.name.removeprefix("data_sample_") + own, fontsize=9)
        grid[2, column].set_xlabel("s")
    for axes, label in zip(grid[:, 0], ("latent, normal", "Σ dz, counts", "slip score, log odds"), strict=True):
        axes.set_ylabel(label)
    grid[0, 0].legend(frameon=False, fontsize=8)
    grid[2, 0].legend(frameon=False, fontsize=8)
    _bars(figure.add_subplot(place[3, :]), report["slip"])
    return save_figure(figure, path)


def _column(axes: np.ndarray, trial: Trial, load: dict[str, np.ndarray]) -> None:
    time = _seconds(trial)
    for line, name in zip(axes, ("latent", "raw counts"), strict=False):
        for finger, label in enumerate(("left", "right")):
            line.plot(time, load[name][finger, :, NORMAL], linewidth=0.8, label=label)
    for line in axes:
        _shade(line, time, trial.slip, {"color": "0.8"})
        _shade(line, time, trial.dropped, {"facecolor": "none", "edgecolor": "0.85", "hatch": "//"})


def _shade(axes: Axes, time: np.ndarray, rows: np.ndarray, look: dict[str, Any]) -> None:
    whole = axes.get_xaxis_transform()  # y from 0 to 1, whatever is drawn later
    axes.fill_between(time, 0, 1, where=rows, transform=whole, linewidth=0, zorder=0, **look)


def _bars(axes: Axes, slip: dict[str, Any]) -> None:
    for place, found in enumerate(slip["detectors"].values()):
        axes.bar(place - 0.2, found["auroc"], 0.4, color="C0", label="all slip frames" if not place else None)
        axes.bar(place + 0.2, found["auroc_onset"], 0.4, color="C1", label="first 0.25 s" if not place else None)
        own = list(found["auroc_by_trial"].values())
        axes.plot([place] * len(own), own, "kd", markersize=4)
    axes.axhline(0.5, color="black", linewidth=0.5)
    axes.set(ylim=(0, 1.25), ylabel="AUROC, leave one trial out", xticks=range(len(slip["detectors"])))
    axes.set_xticklabels(list(slip["detectors"]))
    said = f"{slip['slipping_trials']} of {slip['trials']} trials slip, {slip['onsets']} onsets"
    axes.set_title(f"{said}, {slip['frames']} frames: an indication, no more", fontsize=9)
    axes.legend(frameon=False, ncols=2, loc="upper left")


def _seconds(trial: Trial) -> np.ndarray:
    return np.arange(len(trial.slip)) / RATE_HZ
