"""Pictures of scored rollouts: bars with intervals, an episode's sheet."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.evaluation.rollout import Rollout
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.keys import OUTCOME_NAMES

THUMBNAILS = 6
PICTURE_DPI = 110  # thumbnails need it
COLOURS = {
    "clean": "#2a9d8f",
    "wiped, not clean": "#a8dcd5",
    "residual": "#e9c46a",
    "failed_grasp": "#e76f51",
    "aborted": "#6c757d",
}


def draw_arms(reports: Sequence[ArmReport], path: Path, title: str) -> Path:
    """Draw a stacked bar of outcomes per arm; the dot is clean success with its Wilson interval."""
    figure = Figure(figsize=(8, 1.2 + 0.34 * len(reports)))
    axes = figure.subplots()
    for place, report in enumerate(reports):
        _draw_bar(axes, place, report)
        clean = wilson(report.count("clean"), report.n)
        rate = clean.k / clean.n
        axes.errorbar(
            rate, place, xerr=[[rate - clean.low], [clean.high - rate]], fmt="ko", capsize=3, ms=4
        )
    names = [f"{r.arm}  {r.count('clean')}/{r.n}" for r in reports]
    axes.set_yticks(range(len(reports)), names)
    axes.invert_yaxis()  # the first arm on top
    axes.set_xlim(0, 1.02)
    axes.set_xlabel("share of rollouts (dot: clean success, 95 %)")
    axes.legend(bbox_to_anchor=(1.01, 1), loc="upper left", frameon=False)
    axes.set_title(title)
    return save_figure(figure, path, PICTURE_DPI, crop=True)


def _draw_bar(axes: Axes, place: int, report: ArmReport) -> None:
    counts = {name: report.count(name) for name in (*OUTCOME_NAMES, "clean")}
    counts["wiped, not clean"] = counts["success"] - counts["clean"]
    left = 0.0
    for name, colour in COLOURS.items():
        share = counts[name] / report.n
        label = name.replace("_", " ") if place == 0 else None
        axes.barh(place, share, 0.7, left=left, color=colour, label=label)
        left += share


def write_trace_sheet(path: Path, rollout: Rollout, title: str) -> Path:
    """Draw an episode: thumbnails, press and grip, slip in the hand, ink left."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    rows = figure.subplots(4, 1, height_ratios=[1.3, 1, 1, 1])
    for row in rows[1:3]:
        row.sharex(rows[3])
        row.tick_params(labelbottom=False)
    chosen = np.linspace(0, len(rollout.shots) - 1, THUMBNAILS).astype(int)
    rows[0].imshow(np.concatenate([rollout.shots[i].front for i in chosen], axis=1))
    rows[0].axis("off")
    facts = [rollout.result.outcome]
    if rollout.result.slippage:
        facts.append("slippage")
    if rollout.result.excess_force:
        facts.append("excess_force")
    rows[0].set_title(f"{title}: {', '.join(facts)}")
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
