"""A recorded episode on one time line: film strips, press, forces of both fingers, latents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.evaluation.episode_story import EpisodeStory
from uniforce_vtla.evaluation.finger_estimates import FingerSettings
from uniforce_vtla.figure_file import save_figure

FORCES = (("fx", "#4c78a8"), ("fy", "#e07b39"), ("fz", "#2a9d8f"))
BEYOND = "#e63946"  # limits, and stretches beyond one
WIDTH_IN, FILM_IN, PLOT_IN, RIBBON_IN = 14.0, 1.12, 1.45, 0.8


def draw_timeline(story: EpisodeStory, path: Path) -> Path:
    """Draw everything over the same seconds; letters mark the moments of ``draw_moments``."""
    plots = ["press", *(["friction"] if story.judges_slip else []), *(f"force {f}" for f in story.change)]
    if story.found is None:
        plots = [name for name in plots if name.startswith("force")]
    rows = [*story.films, *plots, *(f"latent {finger}" for finger in story.change)]
    heights = [FILM_IN] * len(story.films) + [PLOT_IN] * len(plots) + [RIBBON_IN] * len(story.change)
    figure = Figure(figsize=(WIDTH_IN, sum(heights) + 0.8), layout="constrained")
    panels = dict(zip(rows, figure.subplots(len(rows), 1, sharex=True, height_ratios=heights), strict=True))
    for camera, film in story.films.items():
        _film(panels[camera], film, story.time_s[-1], camera)
    for number, finger in enumerate(story.change):
        _forces(panels[f"force {finger}"], story, number, finger)
        _ribbon(panels[f"latent {finger}"], story, finger)
    if story.found is not None:
        _press(panels["press"], story)
    if "friction" in panels:
        _friction(panels["friction"], story)
    for name, panel in panels.items():
        if name in plots:
            _mark(panel, story)
    _letters(panels[rows[0]], story)
    panels[rows[-1]].set_xlabel("time [s]")
    return save_figure(figure, path)


def _film(panel: Axes, film: list[np.ndarray], end_s: float, camera: str) -> None:
    panel.imshow(np.concatenate(film, axis=1), extent=(0, end_s, 0, 1), aspect="auto")
    panel.set(yticks=[])
    panel.set_ylabel(camera)


def _press(panel: Axes, story: EpisodeStory) -> None:
    assert story.found is not None
    if story.truth is not None:
        panel.plot(story.time_s, story.truth.press_N, color="k", lw=2.2, alpha=0.25, label="from true forces")
    panel.plot(story.time_s, story.found.press_N, color="#6a4c93", lw=1.4, label="estimate")
    panel.axhline(ScoreLimits().mean_press_N, color=BEYOND, lw=0.8, ls="--", label="limit of its 0.5 s mean")
    panel.set_ylabel("press on board [N]")
    _tidy(panel)


def _friction(panel: Axes, story: EpisodeStory) -> None:
    assert story.found is not None
    if story.truth is not None:
        used = story.truth.friction_used.min(axis=1)
        panel.plot(story.time_s, used, color="k", lw=2.2, alpha=0.25, label="from true forces")
    panel.plot(story.time_s, story.found.friction_used.min(axis=1), color="#bc6c25", label="estimate")
    panel.axhline(FingerSettings().friction_share, color=BEYOND, lw=0.8, ls="--", label="limit")
    panel.set_ylabel("friction used,\nlesser pad")
    _tidy(panel)


def _forces(panel: Axes, story: EpisodeStory, number: int, finger: str) -> None:
    for axis, (name, colour) in enumerate(FORCES):
        if story.true_force_N is not None:
            true = story.true_force_N[:, number, axis]
            panel.plot(story.time_s, true, color=colour, lw=2.6, alpha=0.3, label=f"{name}, true")
        estimate = story.force_N[:, number, axis]
        panel.plot(story.time_s, estimate, color=colour, lw=1.1, label=f"{name}, estimate")
    panel.axhline(0, color="0.7", lw=0.6)
    panel.set_ylabel(f"{finger} finger [N]")
    _tidy(panel)


def _ribbon(panel: Axes, story: EpisodeStory, finger: str) -> None:
    """Rows of the pad from its top down, each as strong as its latents' mean distance from free air."""
    rows = story.strength(finger).mean(axis=2).T  # (g, n)
    panel.imshow(rows, extent=(0, story.time_s[-1], 0, 1), aspect="auto", cmap="magma", vmin=0)
    panel.set(yticks=[])
    panel.set_ylabel(f"{finger}\nlatent,\npad rows", fontsize=8)


def _tidy(panel: Axes) -> None:
    panel.grid(alpha=0.2)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _mark(panel: Axes, story: EpisodeStory) -> None:
    for moment in story.moments:
        panel.axvline(story.time_s[moment.frame], color="0.4", lw=0.6, ls=":")
    for stretch in story.stretches:
        panel.axvspan(
            story.time_s[stretch.first], story.time_s[stretch.end - 1], color=BEYOND, alpha=0.12, lw=0
        )


def _letters(panel: Axes, story: EpisodeStory) -> None:
    for letter, moment in zip("ABCDEFGH", story.moments, strict=False):
        panel.annotate(
            letter,
            (story.time_s[moment.frame], 1.0),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            fontweight="bold",
        )
