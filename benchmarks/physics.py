"""Is the scene's physics right, and what does it cost?  One page of figures and the numbers behind it."""

import itertools
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks import physics_rig as rig
from benchmarks.physics_page import draw_page
from lerobot_env_uniforce_wiping.levels import PadSettings
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from uniforce_cli.boundary import command
from uniforce_vtla.evaluation.episode import ScoreLimits
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json

WIDTHS_m = (0.028, 0.026, 0.024, 0.022, 0.020, 0.018, 0.016)  # commanded, around an eraser of 30 mm
FRICTIONS = (0.3, 0.5, 0.65, 0.8)
GRIPS_m = (0.024, 0.020)  # commanded widths of the slip test
LOAD_SHARES = (0.2, 0.4, 0.6, 0.8, 0.9)  # of the slip load
PRESSES_N = tuple(np.arange(0.0, 12.01, 0.5).tolist())
DEPTHS_m = (0.008, 0.012, 0.014)  # target below first contact
SUBSTEPS = (2, 3, 4, 8, 16, 32)  # the last one is the reference
NOSLIP = (0, 1, 2, 3, 5, 8, 16)


@dataclass
class PhysicsCommand:
    """Measure the scene's physics; write physics.json and its page of figures.

    Example: python -m benchmarks.physics boards=5
    """

    boards: Count = 20  # words whose ink is worn off in the residual curve
    repeats: Count = 3  # of each timed stroke; medians are kept
    results: OutFolder = "outputs/physics"  # physics.json and physics.png


def measure(command: PhysicsCommand) -> dict[str, Any]:
    """Return every panel's numbers."""
    panels: dict[str, Callable[[], Any]] = {
        "indentation": indentation,
        "slip": slip,
        "creep": creep,
        "wear": lambda: wear(command.boards),
        "time_step": lambda: solvers([SolverSettings(substeps=n) for n in SUBSTEPS], command.repeats),
        "noslip": lambda: solvers([SolverSettings(noslip_iterations=n) for n in NOSLIP], command.repeats),
    }
    return {name: panel() for name, panel in tqdm(panels.items(), desc="physics")}


def indentation() -> dict[str, Any]:
    """Return force and depth of both pads over grips, and the largest error against force over stiffness."""
    grips = [rig.squeeze(width) for width in WIDTHS_m]
    force, depth = np.array([g.force_N for g in grips]), np.array([g.depth_mm for g in grips])
    error = np.abs(depth * np.array([PadSettings().flat_N_mm, PadSettings().dome_N_mm]) / force - 1)
    return {"force_N": force.tolist(), "depth_mm": depth.tolist(), "worst_relative_error": float(error.max())}


def slip() -> dict[str, Any]:
    """Return Coulomb's slip loads and the measured ones."""
    loads = [rig.slip_load(mu, width) for mu, width in itertools.product(FRICTIONS, GRIPS_m)]
    worst = max(abs(load.measured_N / load.coulomb_N - 1) for load in loads)
    return {"loads": [asdict(load) for load in loads], "worst_relative_error": worst}


def creep() -> dict[str, Any]:
    """Return sinking speed over load, as a share of the slip load, with and without the no-slip pass."""
    return {
        "share": list(LOAD_SHARES),
        "shipped_mm_s": [rig.creep_mm_s(share) for share in LOAD_SHARES],
        "without_noslip_mm_s": [
            rig.creep_mm_s(share, solver=SolverSettings(noslip_iterations=0)) for share in LOAD_SHARES
        ],
    }


def wear(boards: int) -> dict[str, Any]:
    """Return ink left over press, for several words and adhesions, and the limits around the good window."""
    limits = ScoreLimits()
    left = [[rig.residual_after(press, seed=seed) for press in PRESSES_N] for seed in range(boards)]
    return {
        "press_N": list(PRESSES_N),
        "residual": left,
        "residual_limit": limits.residual_share,
        "press_limit_N": limits.mean_press_N,
    }


def solvers(settings: list[SolverSettings], repeats: int) -> dict[str, Any]:
    """Return press, ink and speed of the same strokes under each setting, timed in turns."""
    strokes: list[list[list[rig.Stroke]]] = [[[] for _ in DEPTHS_m] for _ in settings]
    for _, (i, solver), (j, depth) in itertools.product(range(repeats), enumerate(settings), enumerate(DEPTHS_m)):
        strokes[i][j].append(rig.stroke(depth, solver))
    found = []
    for solver, runs in zip(settings, strokes, strict=True):
        times = [run.times_real_time for depth in runs for run in depth]
        found.append(
            asdict(solver)
            | {"physics_hz": solver.physics_hz, "times_real_time": float(np.median(times))}
            | {"press_N": [depth[0].press_N for depth in runs]}
            | {"residual": [depth[0].residual for depth in runs]}
        )
    return {"depth_m": list(DEPTHS_m), "settings": found}


@command(PhysicsCommand)
def main(command: PhysicsCommand) -> None:
    """Entry of ``python -m benchmarks.physics``."""
    panels = measure(command)
    what = "simulated; nothing hidden in the scene, GelSight left, TacTip right"
    path = write_json(Path(command.results) / "physics.json", {"what": what, **panels} | provenance())
    page = draw_page(panels, path.with_suffix(".png"))
    print(f"indentation: within {100 * panels['indentation']['worst_relative_error']:.2f} % of force / stiffness")
    print(f"slip load: within {100 * panels['slip']['worst_relative_error']:.1f} % of 2 μ F")
    print(f"numbers in {path}, figures in {page}")


if __name__ == "__main__":
    sys.exit(main())
