"""Q2 as a picture: per rig a typical pair and the worst ones, with reference, current and all four branches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.probes.reconstructions import Rig, by_cross_error, cross_error
from uniforce_vtla.figure_file import save_figure

# column title → where the picture is: (attribute of Rig, its key, whose truth it is drawn over)
COLUMNS = (
    ("L reference", "reference", "L", None),
    ("L current", "current", "L", None),
    ("L→L", "drawn", "L->L", "L"),
    ("R→L (cross)", "drawn", "R->L", "L"),
    ("R reference", "reference", "R", None),
    ("R current", "current", "R", None),
    ("R→R", "drawn", "R->R", "R"),
    ("L→R (cross)", "drawn", "L->R", "R"),
)


def draw_reconstructions(rigs: Sequence[Rig], path: Path, worst: int = 2) -> Path:
    """Draw per rig the pair of median cross error and the ``worst`` ones, labelled so.

    Over a reconstruction, red is what it lacks of the true image and blue what it has too much.
    """
    rows = [(rig, label, index) for rig in rigs for label, index in _examples(rig, worst)]
    figure = Figure(figsize=(2 * len(COLUMNS), 1.75 * len(rows) + 0.6), layout="constrained")
    grid = figure.subplots(len(rows), len(COLUMNS), squeeze=False)
    for line, (rig, label, index) in zip(grid, rows, strict=True):
        for axes, (_, attribute, key, truth) in zip(line, COLUMNS, strict=True):
            image = getattr(rig, attribute)[key][index]
            axes.imshow(_coloured(image, None if truth is None else rig.current[truth][index]))
            axes.set(xticks=[], yticks=[])
        _say(line[0], rig, label, index)
    for axes, (title, *_) in zip(grid[0], COLUMNS, strict=True):
        axes.set_title(title, fontsize=9)
    figure.suptitle("Simulated pairs, unseen indenters; red = lacking, blue = too much", fontsize=10)
    return save_figure(figure, path)


def _examples(rig: Rig, worst: int) -> list[tuple[str, int]]:
    order = by_cross_error(rig)
    typical = ("median", order[len(order) // 2])
    return [typical, *((f"worst {rank + 1}", index) for rank, index in enumerate(order[:worst]))]


def _coloured(image: np.ndarray, truth: np.ndarray | None) -> np.ndarray:
    """Return (S', S, 3) of a letterboxed grey image, its difference to the truth in colour."""
    grey = np.repeat(image[..., None], 3, axis=-1)
    if truth is not None:
        gap = truth - image
        grey = np.stack([truth, np.minimum(image, truth), image], axis=-1) * (
            1 - 0.2 * np.abs(gap)[..., None]
        )
    margin = len(image) // 8  # 480 of 640 rows hold the picture
    return np.clip(grey[margin : len(image) - margin], 0, 1)


def _say(axes: Axes, rig: Rig, label: str, index: int) -> None:
    fx, fy, fz = rig.force_N[index]
    names = " + ".join(rig.sensors)
    force = f"({fx:.1f}, {fy:.1f}, {fz:.1f}) N"
    text = f"{names}\n{label}: {rig.indenters[index]}\n{force}\nerror {cross_error(rig)[index]:.2f}"
    axes.set_ylabel(text, rotation=0, ha="right", va="center", fontsize=8)
