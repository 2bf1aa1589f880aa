"""Is the scene's physics right?  One page of figures and the numbers behind it."""

import itertools
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from benchmarks import physics_rig as rig
from lerobot_env_uniforce_wiping.levels import PadSettings
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from uniforce_cli.boundary import command
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json

# commanded, around an eraser of 30 mm
WIDTHS_m = (0.028, 0.026, 0.024, 0.022, 0.020, 0.018, 0.016)
FRICTIONS = (0.3, 0.5, 0.65, 0.8)
GRIPS_m = (0.024, 0.020)  # commanded widths of the slip test
LOAD_SHARES = (0.2, 0.4, 0.6, 0.8, 0.9)  # of the slip load
PRESSES_N = tuple(np.arange(0.0, 12.01, 0.5).tolist())
DEPTHS_m = (0.008, 0.012, 0.014)  # target below first contact
SUBSTEPS = (2, 3, 4, 8, 16, 32)  # the last one is the reference
GREY = "0.45"
BLUE = "#1f6fb2"
ORANGE = "#d9822b"
RED = "#c23b3b"


@dataclass
class PhysicsCommand:
    """Measure the scene's physics; write physics.json and its page of figures.

    Example: python -m benchmarks.physics boards=5
    """

    boards: Count = 20  # words whose ink is worn off in the residual curve
    repeats: Count = 3  # of each timed stroke; medians are kept
    results: OutFolder = "outputs/physics"  # physics.json and physics.png


def measure(command: PhysicsCommand) -> dict[str, Any]:
    return {
        "indentation": indentation(),
        "slip": slip(),
        "creep": creep(),
        "wear": wear(command.boards),
        "time_step": time_step(command.repeats),
    }


def indentation() -> dict[str, Any]:
    """Return force and depth of both pads over grips, and the largest error of stiffness."""
    measured = [rig.squeeze(width) for width in tqdm(WIDTHS_m, desc="grips")]
    force, depth = np.stack(measured, axis=1)  # (widths, 2) each
    error = np.abs(depth * np.array([PadSettings().flat_N_mm, PadSettings().dome_N_mm]) / force - 1)
    return {
        "force_N": force.tolist(),
        "depth_mm": depth.tolist(),
        "worst_relative_error": float(error.max()),
    }


def slip() -> dict[str, Any]:
    loads = []
    worst = 0.0
    for friction, width in tqdm(list(itertools.product(FRICTIONS, GRIPS_m)), desc="slip loads"):
        load = rig.slip_load(friction, width)
        loads.append(load)
        worst = max(worst, abs(load["measured_N"] / load["coulomb_N"] - 1))
    return {"loads": loads, "worst_relative_error": worst}


def creep() -> dict[str, Any]:
    """Return sinking speed over load, a share of the slip load, with and without no-slip pass."""
    without = SolverSettings(noslip_iterations=0)
    return {
        "share": list(LOAD_SHARES),
        "shipped_mm_s": [rig.creep_mm_s(share) for share in LOAD_SHARES],
        "without_noslip_mm_s": [rig.creep_mm_s(share, solver=without) for share in LOAD_SHARES],
    }


def wear(boards: int) -> dict[str, Any]:
    """Return ink left over press, of several words and adhesions, and the good window's limits."""
    limits = ScoreLimits()
    left = [[rig.residual_after(press, seed=seed) for press in PRESSES_N] for seed in range(boards)]
    return {
        "press_N": list(PRESSES_N),
        "residual": left,
        "residual_limit": limits.residual_share,
        "press_limit_N": limits.mean_press_N,
    }


def time_step(repeats: int) -> dict[str, Any]:
    """Return press, ink and speed of the same strokes at each time step, timed in turns."""
    solvers = [SolverSettings(substeps=n) for n in SUBSTEPS]
    strokes: dict[tuple[SolverSettings, float], rig.Stroke] = {}
    times: dict[SolverSettings, list[float]] = {solver: [] for solver in solvers}
    for _ in tqdm(range(repeats), desc="time steps"):
        for solver, depth in itertools.product(solvers, DEPTHS_m):
            stroke = rig.stroke(depth, solver)
            strokes.setdefault((solver, depth), stroke)
            times[solver].append(stroke.times_real_time)
    found = []
    for solver in solvers:
        own = [strokes[solver, depth] for depth in DEPTHS_m]
        found.append(
            asdict(solver)
            | {
                "physics_hz": solver.physics_hz,
                "times_real_time": float(np.median(times[solver])),
                "press_N": [stroke.press_N for stroke in own],
                "residual": [stroke.residual for stroke in own],
            }
        )
    return {"depth_m": list(DEPTHS_m), "settings": found}


def draw_page(panels: dict[str, Any], path: Path) -> Path:
    """Draw five panels and return the picture's path."""
    figure = Figure(figsize=(13, 7.4), layout="constrained")
    axes = figure.subplots(2, 3)
    axes[1, 2].remove()
    _indentation(axes[0, 0], panels["indentation"])
    _slip(axes[0, 1], panels["slip"])
    _creep(axes[0, 2], panels["creep"])
    _wear(axes[1, 0], panels["wear"])
    _time_step(axes[1, 1], panels["time_step"])
    for axis in figure.axes:
        axis.grid(alpha=0.25)
        axis.legend(fontsize=8)
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
    axis.set(
        xlabel="grip, N", ylabel="indentation, mm", title="a pad gives way as its stiffness says"
    )


def _slip(axis: Axes, panel: dict[str, Any]) -> None:
    expected = np.array([load["coulomb_N"] for load in panel["loads"]])
    measured = np.array([load["measured_N"] for load in panel["loads"]])
    line = np.array([0.0, expected.max() * 1.08])
    axis.fill_between(line, 0.95 * line, 1.05 * line, color=GREY, alpha=0.2, label="± 5 %")
    axis.plot(line, line, color=GREY, lw=1)
    axis.plot(expected, measured, "o", color=BLUE)
    axis.set(
        xlabel="2 μ grip, N",
        ylabel="load at which it slides, N",
        title="it slides where Coulomb says",
    )


def _creep(axis: Axes, panel: dict[str, Any]) -> None:
    share = 100 * np.array(panel["share"])
    named = (
        ("as shipped", "shipped_mm_s", BLUE),
        ("without the no-slip pass", "without_noslip_mm_s", RED),
    )
    for name, key, colour in named:
        axis.semilogy(share, np.maximum(np.abs(panel[key]), 1e-5), "o-", color=colour, label=name)
    axis.axhline(0.01, color=GREY, ls="--", lw=1, label="0.01 mm/s asked for")
    axis.set(
        xlabel="load, % of the slip load", ylabel="sinking, mm/s", title="what is held stays held"
    )


def _wear(axis: Axes, panel: dict[str, Any]) -> None:
    press, left = np.array(panel["press_N"]), np.array(panel["residual"])
    low, middle, high = np.percentile(left, [5, 50, 95], axis=0)
    axis.fill_between(press, low, high, color=BLUE, alpha=0.2, label="90 % of boards")
    axis.plot(press, middle, color=BLUE, label="median")
    axis.axhline(panel["residual_limit"], color=GREY, ls="--", lw=1, label="residual limit")
    axis.axvspan(panel["press_limit_N"], press.max(), color=RED, alpha=0.12, label="excess force")
    axis.set(
        xlabel="press, N",
        ylabel="ink left, share",
        title="too light leaves ink, too strong is excess",
    )


def _time_step(axis: Axes, panel: dict[str, Any]) -> None:
    rate = np.array([s["physics_hz"] for s in panel["settings"]])
    press = np.array([s["press_N"] for s in panel["settings"]])
    for i, depth in enumerate(panel["depth_m"]):
        axis.semilogx(rate, press[:, i], "o-", ms=4, label=f"{1000 * depth:g} mm below contact")
    axis.set_xticks(rate, [f"{r:g}" for r in rate], fontsize=8)
    axis.minorticks_off()
    axis.axvline(SolverSettings().physics_hz, color=GREY, ls="--", lw=1, label="shipped")
    axis.set(
        xlabel="physics steps per second", ylabel="press, N", title="finer steps change nothing"
    )


@command(PhysicsCommand)
def main(command: PhysicsCommand) -> None:
    panels = measure(command)
    what = "simulated; nothing hidden in the scene, GelSight left, TacTip right"
    path = Path(command.results) / "physics.json"
    write_json(path, {"what": what, **panels} | provenance())
    page = draw_page(panels, path.with_suffix(".png"))
    deep = 100 * panels["indentation"]["worst_relative_error"]
    print(f"indentation: within {deep:.2f} % of force / stiffness")
    print(f"slip load: within {100 * panels['slip']['worst_relative_error']:.1f} % of 2 μ F")
    print(f"numbers in {path}, figures in {page}")


if __name__ == "__main__":
    sys.exit(main())
