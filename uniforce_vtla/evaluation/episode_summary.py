"""One recorded episode for people: key frames, forces, latents, estimated events, time line."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.episode import ScoreLimits, runs
from uniforce_vtla.evaluation.finger_estimates import (
    FRICTION_SHARE,
    FY,
    FZ,
    HELD_N,
    FingerEstimate,
    lift_frame,
)
from uniforce_vtla.figure_file import save_figure

LETTERS = "ABCDEFGH"  # of the key frames, the same in picture and buttons
FORCES = (("fx", "#4c78a8"), ("fy", "#e07b39"), ("fz", "#2a9d8f"))
BEYOND = "#e63946"  # limits, and stretches beyond one
BAND = "#2a9d8f"  # the press that was asked for
WIDTH_IN = 14.0  # of the time line, inches
FILM_IN = 1.12  # height of its rows
PLOT_IN = 1.6
LATENT_IN = 0.8
SMALL = 9  # points: 11 px on a page as wide as the time line


@dataclass(frozen=True)
class KeyFrame:
    """One frame worth looking at."""

    name: str  # why, e.g. "lifted".
    frame: int  # its number in the episode


@dataclass(frozen=True)
class Stretch:
    """Frames ``first`` … ``end − 1`` beyond a limit; the scores say whether that is an event."""

    name: str
    first: int
    end: int


@dataclass(frozen=True, eq=False)
class EpisodeSummary:
    """An episode of n frames with two fingers, left before right in every array."""

    title: str  # dataset and episode
    time_s: np.ndarray  # (n,)
    films: dict[str, list[np.ndarray]]  # evenly spaced (H, W, 3) uint8 RGB pictures by camera
    force_N: np.ndarray  # (n, 2, 3) estimates, canonical frame
    true_force_N: np.ndarray | None  # the same from a simulator; None for a robot's recording
    # by finger, (n, g, g, L) latent minus its free-air latent, as the sensor sees it
    change: dict[str, np.ndarray]
    key_frames: tuple[KeyFrame, ...]  # in order of time
    found: FingerEstimate | None  # press, friction and events by the estimates; None: unknown
    truth: FingerEstimate | None  # the same by the true forces
    judges_slip: bool  # whether the pads' friction is known
    note: str = ""  # why ``found`` is None

    def strength(self, finger: str) -> np.ndarray:
        """Return (n, g, g): how far each patch's latent is from free air."""
        return np.linalg.norm(self.change[finger], axis=-1)

    @property
    def stretches(self) -> list[Stretch]:
        """Where the estimated press, or the friction both pads use, is beyond its limit."""
        if self.found is None:
            return []
        most_N = ScoreLimits().mean_press_N
        used = self.found.friction_used.min(axis=1)
        beyond = {
            f"press > {most_N:g} N": self.found.press_N > most_N,
            "both pads at their friction limit": used > FRICTION_SHARE,
        }
        found = []
        for name, flags in beyond.items():
            found += [Stretch(name, int(first), int(end)) for first, end in runs(flags)]
        return found

    @property
    def verdict(self) -> list[str]:
        """The estimated events in words."""
        if self.found is None:
            return [f"events can't be estimated: {self.note}"]
        if self.judges_slip:
            return self.found.events
        return [*self.found.events, "slippage isn't judged: the pads' friction wasn't given"]

    @property
    def true_verdict(self) -> list[str]:
        """The same judged by true forces; empty where there are none."""
        if self.truth is None:
            return []
        return self.truth.events


@dataclass(frozen=True)
class TimeLine:
    """The picture of a time line, and where in it the episode begins and ends."""

    path: Path
    left: float  # shares of the picture's width
    right: float


def find_key_frames(force_N: np.ndarray, tool_z_m: np.ndarray) -> dict[str, int]:
    """Return frame by name, in order of time.

    Args:
        force_N: (n, 2, 3) left and right, canonical frame.
        tool_z_m: (n,) measured height.
    """
    grip = force_N[:, :, FZ]
    held = (grip > HELD_N).all(axis=1)
    lifted = lift_frame(grip, tool_z_m)
    found = {"start": 0, "end": len(force_N) - 1, "strongest grip": int(grip.sum(axis=1).argmax())}
    if held.any():
        found["grasped"] = int(held.argmax())
    if lifted is not None:
        found["lifted"] = lifted
        found["strongest push"] = lifted + int(force_N[lifted:, :, FY].sum(axis=1).argmin())
    return dict(sorted(found.items(), key=lambda item: item[1]))


def draw_timeline(summary: EpisodeSummary, path: Path) -> TimeLine:
    """Draw everything over the same seconds; letters mark key frames."""
    events = []
    if summary.found is not None:
        events.append("press")
        if summary.judges_slip:
            events.append("friction")
    plots = events + [f"force {finger}" for finger in summary.change]
    heights_in = dict.fromkeys(summary.films, FILM_IN) | dict.fromkeys(plots, PLOT_IN)
    for finger in summary.change:
        heights_in[f"latent {finger}"] = LATENT_IN
    rows = list(heights_in)
    figure = Figure(figsize=(WIDTH_IN, sum(heights_in.values()) + 0.8), layout="constrained")
    panels: dict[str, Axes] = figure.subplot_mosaic(
        [[row] for row in rows], sharex=True, height_ratios=list(heights_in.values())
    )
    for camera, film in summary.films.items():
        _strip(panels[camera], np.concatenate(film, axis=1), summary.time_s[-1], camera)
    for number, finger in enumerate(summary.change):
        _forces(panels[f"force {finger}"], summary, number, finger)
        # rows of the pad from the top, their latents' mean distance from free air
        pad_rows = summary.strength(finger).mean(axis=2).T  # (g, n)
        label = f"{finger}\nlatent,\npad rows"
        _strip(panels[f"latent {finger}"], pad_rows, summary.time_s[-1], label, fontsize=SMALL)
    for name in events:
        _event(panels[name], summary, name)
    for name in plots:
        _finish(panels[name], summary, names=name == plots[0])
    for number, (letter, frame) in enumerate(zip(LETTERS, summary.key_frames, strict=False)):
        # two lines: neighbours are near
        panels[rows[0]].annotate(
            f"{letter} {frame.name}",
            (summary.time_s[frame.frame], 1.0),
            (0, 3 + 12 * (number % 2)),
            textcoords="offset points",
            ha="center",
            fontsize=SMALL,
            fontweight="bold",
        )
    panels[rows[-1]].set(xlabel="time [s]", xlim=(0, summary.time_s[-1]))
    save_figure(figure, path)
    box = panels[rows[-1]].get_position()  # once drawn
    return TimeLine(path, box.x0, box.x1)


def _strip(
    panel: Axes, picture: np.ndarray, end_s: float, label: str, fontsize: float = 10
) -> None:
    panel.imshow(picture, extent=(0, end_s, 0, 1), aspect="auto", cmap="magma", vmin=0)
    panel.set(yticks=[])
    panel.set_ylabel(label, fontsize=fontsize)


def _event(panel: Axes, summary: EpisodeSummary, name: str) -> None:
    """Draw the press, or the friction the lesser pad uses, with its limit."""

    def plot(estimate: FingerEstimate | None, **style: Any) -> None:
        if estimate is None:
            return
        values = estimate.press_N
        if name == "friction":
            values = estimate.friction_used.min(axis=1)
        panel.plot(summary.time_s, values, **style)

    colour = {"press": "#6a4c93", "friction": "#bc6c25"}[name]
    plot(summary.truth, color="k", lw=2.2, alpha=0.25, label="from true forces")
    plot(summary.found, color=colour, lw=1.4, label="estimate")
    limit: dict[str, Any] = {"color": BEYOND, "lw": 0.8, "ls": "--"}
    if name == "friction":
        panel.axhline(FRICTION_SHARE, label="limit", **limit)
        panel.set_ylabel("friction used,\nlesser pad")
        return
    panel.axhline(ScoreLimits().mean_press_N, label="limit of the 0.5 s mean", **limit)
    low_N, high_N = ScoreLimits().band_N
    label = f"asked for, {low_N:g} to {high_N:g} N"
    panel.axhspan(low_N, high_N, color=BAND, alpha=0.12, lw=0, label=label)
    panel.set_ylabel("press on board [N]")


def _forces(panel: Axes, summary: EpisodeSummary, number: int, finger: str) -> None:
    for axis, (name, colour) in enumerate(FORCES):
        if summary.true_force_N is not None:
            true = summary.true_force_N[:, number, axis]
            panel.plot(summary.time_s, true, color=colour, lw=2.6, alpha=0.3, label=f"{name}, true")
        estimate = summary.force_N[:, number, axis]
        panel.plot(summary.time_s, estimate, color=colour, lw=1.1, label=f"{name}, estimate")
    panel.axhline(0, color="0.7", lw=0.6)
    panel.set_ylabel(f"{finger} finger [N]")


def _finish(panel: Axes, summary: EpisodeSummary, names: bool) -> None:
    """Mark key frames and stretches, with ``names`` in the legend too; add grid and legend."""
    for frame in summary.key_frames:
        panel.axvline(summary.time_s[frame.frame], color="0.4", lw=0.6, ls=":")
    for number, stretch in enumerate(summary.stretches):
        first_s, last_s = summary.time_s[[stretch.first, stretch.end - 1]]
        label = "beyond a limit" if names and number == 0 else None
        panel.axvspan(first_s, last_s, color=BEYOND, alpha=0.12, lw=0, label=label)
    panel.grid(alpha=0.2)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(
        fontsize=SMALL,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.05),
        frameon=False,
        labelspacing=0.25,
    )
