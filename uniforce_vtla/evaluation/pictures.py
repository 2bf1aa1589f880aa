"""Pictures of scored rollouts: bars with intervals, an episode's sheet, a video."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import av
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.arms import OUTCOMES, ArmReport
from uniforce_vtla.evaluation.rollout import Rollout
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.figure_file import save_figure

PICTURE_DPI = 110  # thumbnails need it
COLOURS = {
    "clean": "#2a9d8f",
    "success with an event": "#a8dcd5",
    "residual": "#e9c46a",
    "failed_grasp": "#e76f51",
    "aborted": "#6c757d",
}
PANELS_PER_ROW = 6  # z-profiles that still fit a page
Z_RANGE_MM = (-4.0, 6.0)  # what pressing changes; a look back lifts out of it


def draw_arms(reports: Sequence[ArmReport], path: Path, title: str) -> Path:
    """Draw each arm's outcomes and clean success with a 95 % interval."""
    figure = Figure(figsize=(8, 1.2 + 0.34 * len(reports)))
    axes = figure.subplots()
    draw_outcomes(axes, reports)
    axes.set_title(title)
    return save_figure(figure, path, PICTURE_DPI, crop=True)


def draw_outcomes(axes: Axes, reports: Sequence[ArmReport]) -> None:
    """Draw a stacked bar of outcomes per arm; the dot is clean success with its Wilson interval."""
    for place, report in enumerate(reports):
        _draw_bar(axes, place, report)
        clean = wilson(report.count("clean"), report.n)
        rate = clean.k / clean.n
        axes.errorbar(rate, place, xerr=[[rate - clean.low], [clean.high - rate]], fmt="ko", capsize=3, ms=4)
    names = [f"{r.arm}  {r.count('clean')}/{r.n}" for r in reports]
    axes.set_yticks(range(len(reports)), names)
    axes.invert_yaxis()  # the first arm on top
    axes.set_xlim(0, 1.02)
    axes.set_xlabel("share of rollouts (dot: clean success, 95 %)")
    axes.legend(bbox_to_anchor=(1.01, 1), loc="upper left", frameon=False)


def _draw_bar(axes: Axes, place: int, report: ArmReport) -> None:
    counts = {outcome: report.count(outcome) for outcome in OUTCOMES} | {"clean": report.count("clean")}
    counts["success with an event"] = counts["success"] - counts["clean"]
    left = 0.0
    for name, colour in COLOURS.items():
        share = counts[name] / report.n
        label = name.replace("_", " ") if place == 0 else None
        axes.barh(place, share, 0.7, left=left, color=colour, label=label)
        left += share


def draw_success_over_demos(curves: Mapping[str, Mapping[int, ArmReport]], path: Path) -> Path:
    """Draw clean success with its 95 % interval over the number of demos, a curve per arm."""
    figure = Figure(figsize=(5.6, 3.6))
    axes = figure.subplots()
    for name, curve in curves.items():
        clean = [wilson(report.count("clean"), report.n) for report in curve.values()]
        rates = np.array([p.k / p.n for p in clean])
        spread = np.abs(np.array([(p.low, p.high) for p in clean]).T - rates)
        axes.errorbar([*curve], rates, yerr=spread, fmt="o-", capsize=3, ms=4, label=name)
    every = sorted({demos for curve in curves.values() for demos in curve})
    axes.set_xscale("log")
    axes.set_xticks(every, [str(demos) for demos in every])
    axes.minorticks_off()
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("demos")
    axes.set_ylabel("clean success, 95 %")
    axes.legend(frameon=False)
    return save_figure(figure, path, PICTURE_DPI, crop=True)


def draw_z_profiles(reports: Sequence[ArmReport], path: Path) -> Path:
    """Draw each arm's tool height over the wipe: median, and the middle half of all rollouts as a band.

    A board's height and tilt differ between scenes, so every profile is taken against its own median; medians, since
    who looks back at the board lifts by centimetres between two sweeps.
    """
    shown = [r for r in reports if any(row.z_profile_mm for row in r.rows)]
    columns = min(max(len(shown), 1), PANELS_PER_ROW)
    rows = max(-(-len(shown) // columns), 1)
    figure = Figure(figsize=(1.0 + 2.3 * columns, 0.4 + 2.6 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for panel in panels.flat[len(shown) :]:
        panel.axis("off")
    for panel, report in zip(panels.flat, shown, strict=False):
        height = np.array([row.z_profile_mm for row in report.rows if row.z_profile_mm])
        height -= np.median(height, axis=1, keepdims=True)
        share = np.linspace(0, 100, height.shape[1])
        low, middle, high = np.percentile(height, [25, 50, 75], axis=0)
        panel.fill_between(share, low, high, alpha=0.25, color="#2a9d8f")
        panel.plot(share, middle, color="#2a9d8f")
        panel.set_title(f"{report.arm}\nhalf within {np.median(np.abs(height)):.2f} mm", fontsize=9)
        panel.set_ylim(*Z_RANGE_MM)
        panel.set_xlabel("% of the wipe", fontsize=8)
    figure.supylabel("tool height about its median, mm", fontsize=9)
    return save_figure(figure, path, PICTURE_DPI, crop=True)


def write_trace_sheet(path: Path, rollout: Rollout, title: str) -> Path:
    """Draw an episode: thumbnails, press and grip, slip in the hand, ink left."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    rows = figure.subplots(4, 1, height_ratios=[1.3, 1, 1, 1])
    for row in rows[1:3]:
        row.sharex(rows[3])
        row.tick_params(labelbottom=False)
    rows[0].imshow(_thumbnails(rollout.frames))
    rows[0].axis("off")
    events = [name for name in ("slippage", "excess_force") if getattr(rollout.result, name)]
    rows[0].set_title(f"{title}: {rollout.result.outcome}{', ' + ', '.join(events) if events else ''}")
    trace = rollout.trace
    time_s = np.asarray(trace.time_s)
    rows[1].plot(time_s, trace.press_N, label="press on board")
    rows[1].plot(time_s, trace.grip_left_N, label="grip, left pad", alpha=0.7)
    rows[1].plot(time_s, trace.grip_right_N, label="grip, right pad", alpha=0.7)
    rows[1].set_ylabel("force, N")
    rows[1].legend(frameon=False, ncols=3, fontsize=8)
    rows[2].plot(time_s, np.asarray(trace.slip_mm), color="#e76f51")
    rows[2].set_ylabel("slip, mm")
    rows[3].plot(time_s, 100 * np.asarray(trace.residual), color="k")
    rows[3].set_ylabel("ink left, %")
    rows[3].set_xlabel("s")
    return save_figure(figure, path, PICTURE_DPI, crop=True)


def _thumbnails(frames: Sequence[np.ndarray], count: int = 6) -> np.ndarray:
    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, count).astype(int)]
    return np.concatenate(chosen, axis=1)


def write_video(path: Path, frames: Sequence[np.ndarray], fps: int) -> Path:
    """Write (H, W, 3) uint8 frames as an h264 video that browsers play."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("h264", rate=fps)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())
    return path
