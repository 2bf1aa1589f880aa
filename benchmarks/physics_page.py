"""The page of figures about the scene's physics."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lerobot_env_uniforce_wiping.levels import PadSettings
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from uniforce_vtla.figure_file import save_figure

GREY, BLUE, ORANGE, RED, GREEN = "0.45", "#1f6fb2", "#d9822b", "#c23b3b", "#3f8f4f"


def draw_page(panels: dict[str, Any], path: Path) -> Path:
    """Draw six panels from the numbers of ``python -m benchmarks.physics`` and return the picture's path."""
    figure = Figure(figsize=(13, 7.4), layout="constrained")
    axes = figure.subplots(2, 3)
    _indentation(axes[0, 0], panels["indentation"])
    _slip(axes[0, 1], panels["slip"])
    _creep(axes[0, 2], panels["creep"])
    _wear(axes[1, 0], panels["wear"])
    _time_step(axes[1, 1], panels["time_step"])
    _speed(axes[1, 2], panels["time_step"], panels["noslip"])
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    figure.suptitle("Physics of the wiping scene (simulated)")
    return save_figure(figure, path)


def _indentation(axis: Axes, panel: dict[str, Any]) -> None:
    force, depth = np.array(panel["force_N"]), np.array(panel["depth_mm"])
    line = np.array([0.0, force.max() * 1.05])
    pads = PadSettings()
    shown = ("GelSight, flat", pads.flat_N_mm, BLUE), ("TacTip, dome", pads.dome_N_mm, ORANGE)
    for i, (name, K, colour) in enumerate(shown):
        axis.plot(line, line / K, color=colour, lw=1, label=f"{name}: force / {K:g} N/mm")
        axis.plot(force[:, i], depth[:, i], "o", color=colour)
    axis.set(xlabel="grip, N", ylabel="indentation, mm", title="a pad gives way as its stiffness says")
    axis.legend(fontsize=8)


def _slip(axis: Axes, panel: dict[str, Any]) -> None:
    expected = np.array([load["coulomb_N"] for load in panel["loads"]])
    measured = np.array([load["measured_N"] for load in panel["loads"]])
    line = np.array([0.0, expected.max() * 1.08])
    axis.fill_between(line, 0.95 * line, 1.05 * line, color=GREY, alpha=0.2, label="± 5 %")
    axis.plot(line, line, color=GREY, lw=1)
    axis.plot(expected, measured, "o", color=BLUE)
    axis.set(xlabel="2 μ grip, N", ylabel="load at which it slides, N", title="it slides where Coulomb says")
    axis.legend(fontsize=8)


def _creep(axis: Axes, panel: dict[str, Any]) -> None:
    share = 100 * np.array(panel["share"])
    floor = 1e-5
    for name, key, colour in (
        ("as shipped", "shipped_mm_s", BLUE),
        ("without the no-slip pass", "without_noslip_mm_s", RED),
    ):
        axis.semilogy(share, np.maximum(np.abs(panel[key]), floor), "o-", color=colour, label=name)
    axis.axhline(0.01, color=GREY, ls="--", lw=1, label="0.01 mm/s asked for")
    axis.set(xlabel="load, % of the slip load", ylabel="sinking, mm/s", title="what is held stays held")
    axis.legend(fontsize=8)


def _wear(axis: Axes, panel: dict[str, Any]) -> None:
    press, left = np.array(panel["press_N"]), np.array(panel["residual"])
    low, middle, high = np.percentile(left, [5, 50, 95], axis=0)
    axis.fill_between(press, low, high, color=BLUE, alpha=0.2, label="90 % of boards")
    axis.plot(press, middle, color=BLUE, label="median")
    axis.axhline(panel["residual_limit"], color=GREY, ls="--", lw=1, label="residual limit")
    axis.axvspan(panel["press_limit_N"], press.max(), color=RED, alpha=0.12, label="excess force")
    axis.set(xlabel="press, N", ylabel="ink left, share", title="too light leaves ink, too strong is excess")
    axis.legend(fontsize=8)


def _time_step(axis: Axes, panel: dict[str, Any]) -> None:
    rate = np.array([s["physics_hz"] for s in panel["settings"]])
    press = np.array([s["press_N"] for s in panel["settings"]])
    for i, depth in enumerate(panel["depth_m"]):
        axis.semilogx(rate, press[:, i], "o-", ms=4, label=f"{1000 * depth:g} mm below contact")
    axis.set_xticks(rate, [f"{r:g}" for r in rate], fontsize=8)
    axis.minorticks_off()
    axis.axvline(SolverSettings().physics_hz, color=GREY, ls="--", lw=1, label="shipped")
    axis.set(xlabel="physics steps per second", ylabel="press, N", title="finer steps change nothing")
    axis.legend(fontsize=8)


def _speed(axis: Axes, time_step: dict[str, Any], noslip: dict[str, Any]) -> None:
    """Press error against the finest time step, over speed: time step and no-slip passes as two paths."""
    reference = np.array(time_step["settings"][-1]["press_N"])
    shipped = SolverSettings()
    for name, panel, key, colour in (
        ("time step (Hz)", time_step, "physics_hz", BLUE),
        ("no-slip passes", noslip, "noslip_iterations", ORANGE),
    ):
        settings = [s for s in panel["settings"] if s["press_N"] != time_step["settings"][-1]["press_N"]]
        speed = [s["times_real_time"] for s in settings]
        error = [np.abs(np.array(s["press_N"]) - reference).max() for s in settings]
        axis.loglog(speed, error, "o-", ms=4, color=colour, label=name)
        for s, x, y in zip(settings, speed, error, strict=True):
            axis.annotate(f"{s[key]:g}", (x, y), fontsize=7, xytext=(3, 3), textcoords="offset points")
            if (s["substeps"], s["noslip_iterations"]) == (shipped.substeps, shipped.noslip_iterations):
                axis.plot(x, y, "*", ms=13, color=GREEN, label="shipped" if key == "physics_hz" else None)
    axis.set(xlabel="simulated seconds per CPU second", ylabel="worst press error, N", title="speed, accuracy")
    axis.legend(fontsize=8)
