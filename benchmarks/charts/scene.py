"""The scene by its time step: what a simulated second costs, how far presses are off, and who wipes clean in it."""

import itertools
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from joblib import delayed

from benchmarks.charts.front import Point, publish
from benchmarks.ledger import played
from benchmarks.physics import SUBSTEPS, solvers
from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.actors import Arm, disturbed
from benchmarks.stress.disturbed import Disturbance
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from uniforce_cli.boundary import Level, command
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.options import Count, Numbers, OutFolder, Policies, Seed, Workers, split
from uniforce_vtla.results_file import provenance, write_json


@dataclass
class SceneChartCommand:
    """Time the scene's physics with finer and coarser steps and roll out the expert, V+T and V in it; chart both.

    V is V+T whose touch is masked. Run it again to go on.

    Example: python -m benchmarks.charts.scene rollouts=60
    """

    policy: Policies = "shipped"  # V+T: checkpoint folders that take turns
    level: Level = "touch"
    substeps: Numbers = "2,3,4,16"  # physics steps per force sample that are rolled out
    rollouts: Count = 60  # scenes, the same for every cell
    first_seed: Seed = BLOCKS["development"].start
    repeats: Count = 3  # of each timed stroke
    workers: Workers = 2
    out: OutFolder = "outputs/charts"  # episodes so far, chart_scene.json and .png


def hertz(substeps: int) -> str:
    return f"{SolverSettings(substeps).physics_hz:.0f} Hz"


def points(settings: list[dict[str, Any]], clean: dict[str, dict[str, Any]]) -> list[Point]:
    """Return a point per time step that was rolled out: what it costs, and V+T's clean wipes with their interval."""
    found = []
    for setting in settings:
        name, default = hertz(setting["substeps"]), setting["substeps"] == SolverSettings.substeps
        if share := clean.get(f"V+T, {name}"):
            cost, rate = 1000 / setting["times_real_time"], share["k"] / share["n"]
            found.append(Point(name, cost, rate, share["low"], share["high"], default))
    return found


def pressed(settings: list[dict[str, Any]]) -> dict[str, list[float]]:
    """Return time step → its presses over those of the finest, at three depths."""
    finest = np.array(settings[-1]["press_N"])
    return {
        hertz(one["substeps"]): (np.array(one["press_N"]) / finest).round(4).tolist()
        for one in settings
    }


def roll(config: SceneChartCommand) -> list[dict[str, Any]]:
    """Return a row per time step, arm and scene; those of an earlier run are kept."""
    policies = tuple(split(config.policy))
    arms = (
        Arm("expert", acts="expert"),
        Arm("V+T", policies=policies),
        Arm("V", policies=policies, masked=True),
    )
    first, steps, episodes = config.first_seed, [int(n) for n in split(config.substeps)], []
    for seed, arm, substeps in itertools.product(
        range(first, first + config.rollouts), arms, steps
    ):
        cell, physics = f"{arm.name}, {hertz(substeps)}", Disturbance(substeps=substeps)
        job = delayed(disturbed)(arm, config.level, arm.sensor, physics, cell, seed, first)
        episodes.append((cell, seed, job))
    rows = played(Path(config.out) / f"chart_scene_{first}.jsonl", episodes, config.workers)
    return [row for row in rows if row["seed"] < first + config.rollouts]


def ranked(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return cell → clean, n and the 95 % interval."""
    cells: dict[str, list[bool]] = {}
    for row in rows:
        cells.setdefault(row["cell"], []).append(row["clean"])
    return {cell: asdict(wilson(sum(clean), len(clean))) for cell, clean in cells.items()}


@command(SceneChartCommand)
def main(config: SceneChartCommand) -> None:
    """Entry of ``python -m benchmarks.charts.scene``."""
    settings = solvers([SolverSettings(n) for n in SUBSTEPS], config.repeats)["settings"]
    clean = ranked(roll(config))
    shown, cost, score = (
        points(settings, clean),
        "ms of a core per simulated second",
        "clean wipes of V+T",
    )
    path, title = (
        Path(config.out) / "chart_scene.json",
        "time step of the scene, simulated, no pictures",
    )
    content = {"family": "scene"} | publish(shown, path.with_suffix(".png"), title, cost, score)
    content |= {"level": config.level, "clean": clean, "press_over_finest": pressed(settings)}
    content["seeds"] = [config.first_seed, config.first_seed + config.rollouts - 1]
    for cell, share in clean.items():
        print(
            f"{cell:18} clean {share['k']} of {share['n']} [{share['low']:.2f}, {share['high']:.2f}]"
        )
    print(f"* on the front; written to {write_json(path, content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
