"""Chosen moments of a recorded episode side by side: what the cameras saw, and what the fingers felt."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.episode_story import EpisodeStory, Moment
from uniforce_vtla.figure_file import save_figure

SIDE_IN = 2.1  # of a picture
LETTERS = "ABCDEFGH"


def draw_moments(story: EpisodeStory, path: Path) -> Path:
    """Draw a column per moment: cameras, then of each finger its raw frame if kept, markers, latent change."""
    cameras = list(story.films)
    rows = [
        *cameras,
        *(f"{finger} {part}" for finger in story.change for part in _parts(story, finger)),
    ]
    heights = [0.76 if name.endswith(("markers", "raw")) else 1.0 for name in rows]
    size = (SIDE_IN * len(story.moments) + 0.6, SIDE_IN * sum(heights) + 0.9)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(rows), len(story.moments), squeeze=False, height_ratios=heights)
    for column, letter, moment in zip(grid.T, LETTERS, story.moments, strict=False):
        panels = dict(zip(rows, column, strict=True))
        column[0].set_title(f"{letter}  {moment.name}\n{story.time_s[moment.frame]:.2f} s", fontsize=10)
        for camera in cameras:
            panels[camera].imshow(moment.cameras[camera])
        for finger, picture in moment.raw.items():
            panels[f"{finger} raw"].imshow(picture)
        for number, finger in enumerate(story.change):
            panels[f"{finger} markers"].imshow(moment.markers[finger], interpolation="antialiased")
            _heat(panels[f"{finger} latent"], story, moment, number, finger)
    for name, panel in zip(rows, grid[:, 0], strict=True):
        panel.set_ylabel(name)
    for panel in grid.flat:
        panel.set(xticks=[], yticks=[])
    return save_figure(figure, path)


def _parts(story: EpisodeStory, finger: str) -> tuple[str, ...]:
    kept = ("raw",) if finger in story.moments[0].raw else ()
    return (*kept, "markers", "latent")


def _heat(panel: Axes, story: EpisodeStory, moment: Moment, number: int, finger: str) -> None:
    strength = story.strength(finger)
    panel.imshow(strength[moment.frame], cmap="magma", vmin=0, vmax=max(float(strength.max()), 1e-6))
    said = [f"estimate {_newtons(story.force_N[moment.frame, number])}"]
    if story.true_force_N is not None:
        said.append(f"true {_newtons(story.true_force_N[moment.frame, number])}")
    panel.set_xlabel("\n".join(said), fontsize=8)


def _newtons(force_N: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:+.1f}" for value in force_N) + ") N"


def draw_channels(story: EpisodeStory, moment: Moment, path: Path) -> Path:
    """Draw every latent channel of both fingers at one moment, on one colour scale."""
    fingers = list(story.change)
    channels = story.change[fingers[0]].shape[-1]
    figure = Figure(figsize=(1.6 * channels + 1.4, 1.75 * len(fingers) + 0.6), layout="constrained")
    grid = figure.subplots(len(fingers), channels, squeeze=False)
    limit = max(float(np.abs(story.change[f][moment.frame]).max()) for f in fingers) or 1.0
    for line, finger in zip(grid, fingers, strict=True):
        line[0].set_ylabel(finger)
        for channel, panel in enumerate(line):
            values = story.change[finger][moment.frame, :, :, channel]
            image = panel.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit)
            panel.set(xticks=[], yticks=[], title=f"z{channel}")
    figure.colorbar(image, ax=grid, shrink=0.8, label="latent − free air")
    return save_figure(figure, path)
