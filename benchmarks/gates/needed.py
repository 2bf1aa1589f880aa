"""Was noise added until touch was needed?  Clean wipes against pull and unevenness of `touch`.

One of the two is changed at a time, the other stays as in the level. Scripts keep what they learnt
at the level itself.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from joblib import delayed
from matplotlib.figure import Figure

from benchmarks.gates.__main__ import GATES
from benchmarks.gates.fitting import Fitted, fit
from benchmarks.ledger import played
from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.actors import Arm, play, row_of
from benchmarks.stress.disturbed import SCENE_OPERATORS, DisturbedEnv
from benchmarks.stress.row import Row
from lerobot_env_uniforce_wiping.episodes import run_script
from lerobot_env_uniforce_wiping.hidden import PullSettings, UnevenSettings
from lerobot_env_uniforce_wiping.levels import LEVELS, level_hash
from uniforce_cli.boundary import command, worker_process
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.options import Count, OutFile, OutFolder, Seed, Text, Workers, split
from uniforce_vtla.results_file import provenance, write_json

LEVEL = "touch"
PULL = "P3 stronger pull"
BOARD = "B1 rougher board"
LEVEL_PULL_N = PullSettings().sd_N
LEVEL_UNEVEN_mm = 1000 * UnevenSettings().sd_m
# axis → operator that changes it, its value in the level, values shown
AXES: dict[str, tuple[str, float, tuple[float, ...]]] = {
    "pull, sd per axis, N": (PULL, LEVEL_PULL_N, (0, 1, 2, 3, 4)),
    "unevenness, sd, mm": (BOARD, LEVEL_UNEVEN_mm, (0, 0.25, 0.5, 0.85, 1)),
}
SCRIPTS = ("expert", "open loop", "lag identifying", "keeps height", "plane known")
# forces that a KUKA without a tool reports at rest, ±1.5 Nm half a metre from its base (facts of the level)
REAL_ARM_N = 3.0


@dataclass
class NeededCommand:
    """Roll out scripts and, where named, policies under every pull and unevenness; draw both curves.

    Example: python -m benchmarks.gates.needed episodes=20 policy=arms/vt/seed0 blind=arms/v/seed0
    """

    episodes: Count = 20  # scenes, the same for every cell
    first_seed: Seed = BLOCKS["is touch needed"].start
    policy: Text = ""  # V+T: checkpoint folders that take turns; "" = scripts alone
    blind: Text = ""  # V: checkpoint folders that take turns; "" = scripts alone
    learn_from: Count = 250  # scenes that scripts learn from, as for the gates
    sweep_on: Count = 15
    workers: Workers = 2
    work: OutFolder = "outputs/gates"  # what was learnt, and episodes so far: run it again to go on
    out: OutFile = "outputs/chart_touch_needed.json"


def cells() -> list[tuple[str, float]]:
    """Return operator and factor of each cell; the level itself is in both axes."""
    found = []
    for operator, usual, values in AXES.values():
        for value in values:
            found.append((operator, round(value / usual, 4)))
    return found


def _cell(name: str, operator: str, factor: float) -> str:
    return f"{name}, {operator} {factor:g}"


def _script(
    name: str, operator: str, factor: float, seed: int, fitted: Fitted, folder: Path
) -> Row:
    worker_process()
    env = DisturbedEnv(SCENE_OPERATORS[operator].disturb(factor), level=LEVEL, drawn=())
    result = run_script(env, GATES[name].make(fitted, folder), seed)
    return row_of(_cell(name, operator, factor), env, result)


def roll(config: NeededCommand, fitted: Fitted) -> list[dict[str, Any]]:
    """Return a row per actor, cell and scene; those of an earlier run are kept."""
    folder = Path(config.work)
    first = config.first_seed
    arms = []
    if config.policy:
        arms.append(Arm("V+T", policies=tuple(split(config.policy))))
    if config.blind:
        arms.append(Arm("V", policies=tuple(split(config.blind))))
    episodes = []
    for seed in range(first, first + config.episodes):
        for operator, factor in cells():
            for name in SCRIPTS:
                cell = _cell(name, operator, factor)
                job = delayed(_script)(name, operator, factor, seed, fitted, folder)
                episodes.append((cell, seed, job))
            for arm in arms:
                cell = _cell(arm.name, operator, factor)
                job = delayed(play)(arm, LEVEL, arm.sensor, operator, factor, cell, seed, first)
                episodes.append((cell, seed, job))
    return played(folder / f"needed_{first}.jsonl", episodes, config.workers)


def curves(rows: list[dict[str, Any]], seeds: range) -> dict[str, dict[str, dict[str, Any]]]:
    """Return axis → actor → values, clean and n."""
    counted: dict[str, list[bool]] = {}
    for row in rows:
        if row["seed"] in seeds:
            counted.setdefault(row["cell"], []).append(row["clean"])
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for axis, (operator, usual, values) in AXES.items():
        for actor in (*SCRIPTS, "V+T", "V"):
            clean = []
            n = []
            for value in values:
                own = counted.get(_cell(actor, operator, round(value / usual, 4)), [])
                clean.append(sum(own))
                n.append(len(own))
            if any(n):
                line = {"values": list(values), "clean": clean, "n": n}
                found.setdefault(axis, {})[actor] = line
    return found


def draw(found: dict[str, dict[str, dict[str, Any]]], path: Path) -> Path:
    """Draw a panel per axis: share of clean wipes against the value; dotted where the level is."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for panel, (axis, lines) in zip(panels, found.items(), strict=True):
        for actor, line in lines.items():
            share = np.array(line["clean"]) / np.maximum(line["n"], 1)
            panel.plot(line["values"], share, marker="o", markersize=3, label=actor)
        panel.axvline(AXES[axis][1], color="0.5", linestyle=":")
        panel.set(xlabel=f"{axis} (dotted: the level)", ylim=(-0.03, 1.03))
    panels[0].axvspan(0, REAL_ARM_N, color="0.95", zorder=0)
    panels[0].set(
        ylabel="clean, simulated", title="grey: unknown forces up to those published of a real arm"
    )
    panels[-1].legend(fontsize=7)
    return save_figure(figure, path)


@command(NeededCommand)
def main(config: NeededCommand) -> None:
    """Entry of ``python -m benchmarks.gates.needed``."""
    learnt = BLOCKS["what scripts of the gates learn from"].start
    fitted = fit(
        LEVEL,
        "servo",
        config.learn_from,
        config.sweep_on,
        learnt,
        config.workers,
        Path(config.work),
    )
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    found = curves(roll(config, fitted), seeds)
    for axis, lines in found.items():
        for actor, line in lines.items():
            said = "  ".join(f"{v:g}: {k}/{n}" for v, k, n in zip(*line.values(), strict=True))
            print(f"{axis:22} {actor:16} {said}")
    content = {
        "level": LEVEL,
        "level_hash": level_hash(LEVELS[LEVEL]),
        "seeds": [seeds[0], seeds[-1]],
        "axes": found,
    }
    path = write_json(Path(config.out), content | provenance())
    print(f"written to {path} and {draw(found, path.with_suffix('.png'))}")


if __name__ == "__main__":
    sys.exit(main())
