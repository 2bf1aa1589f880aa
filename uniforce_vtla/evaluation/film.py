"""A rollout as a film: camera and markers, below them the press on the board within its band."""

from collections.abc import Iterator

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.rollout import Rollout

FILM_HZ = 5
PICTURE_PX = 240  # height of camera and markers
WIDTH_PX = 560
PLOT_PX = 150  # height of the plot
DPI = 80
TOP_N = 12.0  # of the plot: presses above it are far too hard


def film(rollout: Rollout, band_N: tuple[float, float]) -> Iterator[np.ndarray]:
    """Yield ``FILM_HZ`` frames (H, W, 3) uint8 per second of the episode, in real time.

    An episode that ended before its first step has one frame.

    Args:
        rollout: one that kept its shots.
        band_N: of the press that the task asks for.
    """
    time_s = np.asarray(rollout.trace.time_s)
    plot, columns = _press_plot(rollout, band_N)
    steps = np.array([shot.step for shot in rollout.shots])
    for now_s in np.arange(0, _end_s(time_s), 1 / FILM_HZ):
        step = int(np.searchsorted(time_s, now_s, side="right"))
        seen = int(np.searchsorted(steps, step, side="right")) - 1
        shot = rollout.shots[max(0, seen)]
        below = plot.copy()
        if len(columns):
            column = int(columns[min(step, len(columns) - 1)])
            below[:, column : column + 2] = 0  # where the film is
        yield np.concatenate([_pictures(shot.front, shot.markers), below])


def _end_s(time_s: np.ndarray) -> float:
    """Return the end of (n,) control steps, a moment where there are none."""
    return float(time_s[-1]) if len(time_s) else 1 / FILM_HZ


def _pictures(front: np.ndarray, markers: np.ndarray | None) -> np.ndarray:
    """Return (PICTURE_PX, WIDTH_PX, 3): the camera, and beside it the markers or nothing."""
    row = np.zeros((PICTURE_PX, WIDTH_PX, 3), np.uint8)
    row[:, :PICTURE_PX] = cv2.resize(front, (PICTURE_PX, PICTURE_PX))
    if markers is not None:
        width = WIDTH_PX - PICTURE_PX
        height = min(PICTURE_PX, width * markers.shape[0] // markers.shape[1])
        row[:height, PICTURE_PX:] = cv2.resize(
            markers, (width, height), interpolation=cv2.INTER_AREA
        )
    return row


def _press_plot(rollout: Rollout, band_N: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the plot (PLOT_PX, WIDTH_PX, 3), and the column of each control step in it."""
    time_s = np.asarray(rollout.trace.time_s)
    figure = Figure(figsize=(WIDTH_PX / DPI, PLOT_PX / DPI), dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.axhspan(*band_N, color="#2a9d8f", alpha=0.25, lw=0)
    axes.plot(time_s, rollout.trace.press_N, color="k", lw=1)
    axes.set(xlim=(0, _end_s(time_s)), ylim=(0, TOP_N), xlabel="time, s", ylabel="press, N")
    canvas.draw()
    places = axes.transData.transform(np.stack([time_s, np.zeros_like(time_s)], axis=1))
    return np.asarray(canvas.buffer_rgba())[..., :3].copy(), places[:, 0]
