"""Was noise added until touch was needed?  Clean wipes against the pull and the unevenness of level `touch`.

One of the two is changed at a time, the other stays as in the level. Scripts keep what they learnt at the level itself.
"""

import itertools
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
PULL, BOARD = "P3 stronger pull", "B1 rougher board"
LEVEL_PULL_N, LEVEL_UNEVEN_mm = PullSettings().sd_N, 1000 * UnevenSettings().sd_m
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
    return [
        (operator, round(value / usual, 4))
        for operator, usual, values in AXES.values()
        for value in values
    ]


def _script(
    name: str, operator: str, factor: float, seed: int, fitted: Fitted, folder: Path
) -> Row:
    worker_process()
    env = DisturbedEnv(SCENE_OPERATORS[operator].disturb(factor), level=LEVEL, drawn=())
    return row_of(
        _cell(name, operator, factor), env, run_script(env, GATES[name].make(fitted, folder), seed)
    )


def _cell(name: str, operator: str, factor: float) -> str:
    return f"{name}, {operator} {factor:g}"


def roll(config: NeededCommand, fitted: Fitted) -> list[dict[str, Any]]:
    """Return a row per actor, cell and scene; those of an earlier run are kept."""
    folder, first = Path(config.work), config.first_seed
    arms = [
        Arm(n, policies=tuple(split(given)))
        for n, given in (("V+T", config.policy), ("V", config.blind))
        if given
    ]
    episodes = []
    for seed, (operator, factor) in itertools.product(
        range(first, first + config.episodes), cells()
    ):
        for name in SCRIPTS:
            job = delayed(_script)(name, operator, factor, seed, fitted, folder)
            episodes.append((_cell(name, operator, factor), seed, job))
        for arm in arms:
            cell = _cell(arm.name, operator, factor)
            episodes.append(
                (
                    cell,
                    seed,
                    delayed(play)(arm, LEVEL, arm.sensor, operator, factor, cell, seed, first),
                )
            )
    return played(folder / f"needed_{first}.jsonl", episodes, config.workers)


def curves(rows: list[dict[str, Any]], seeds: range) -> dict[str, dict[str, dict[str, Any]]]:
    """Return axis → actor → values, clean and n."""
    counted: dict[str, list[bool]] = {}
    for row in rows:
        if row["seed"] in seeds:
            counted.setdefault(row["cell"], []).append(row["clean"])
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for axis, (operator, usual, values) in AXES.items():
        names = [_cell("", operator, round(value / usual, 4)) for value in values]
        for actor in (*SCRIPTS, "V+T", "V"):
            own = [counted.get(actor + name, []) for name in names]
            if any(own):
                line = {
                    "values": list(values),
                    "clean": [sum(c) for c in own],
                    "n": [len(c) for c in own],
                }
                found.setdefault(axis, {})[actor] = line
    return found


def draw(found: dict[str, dict[str, dict[str, Any]]], path: Path) -> Path:
    """Draw a panel per axis: share of clean wipes against the value; dotted where the level is."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for panel, (axis, lines) in zip(panels, found.items(), strict=True):
        for actor, line in lines.items():
            share = [k / max(n, 1) for k, n in zip(line["clean"], line["n"], strict=True)]
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
