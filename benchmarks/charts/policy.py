"""Policies by how many steps of a chunk they execute: milliseconds of a core per control step against clean wipes.

The scenes are development scenes: this chart chooses ``tiny``'s default.
"""

import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.charts.front import Point, publish
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_cli.boundary import Worn, command
from uniforce_cli.score import score_arms
from uniforce_cli.score_settings import ScoreConfig
from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.file_hashes import write_hashes
from uniforce_vtla.options import Count, OutFolder, Policies, Seed, Workers, split
from uniforce_vtla.results_file import provenance, write_json

EXECUTED = (1, 2, 3, 6)  # steps of 16
CONTROL_ms = 1000 / 30


@dataclass
class PolicyChartCommand:
    """Score the same checkpoints executing 1, 2, 3 and 6 steps of each chunk, on the same scenes.

    Example: python -m benchmarks.charts.policy policy=arms/vt/seed0,arms/vt/seed1,arms/vt/seed2
    """

    policy: Policies = "shipped"  # checkpoint folders that take turns
    right_sensor: Worn = ""  # "" = the demonstrations' own unit
    rollouts: Count = 24  # scenes
    first_seed: Seed = 20_000  # development
    workers: Workers = 2
    # checkpoints, rows, chart_policy.json and .png; run it again to go on
    out: OutFolder = "outputs/chart_policy"


def executing(checkpoint: Path, steps: int, folder: Path) -> Path:
    """Return a copy of a checkpoint that executes so many steps of a chunk."""
    if not (folder / "config.json").is_file():
        shutil.copytree(checkpoint, folder, dirs_exist_ok=True)
        config = json.loads((folder / "config.json").read_text()) | {"n_action_steps": steps}
        (folder / "config.json").write_text(json.dumps(config, indent=4))
        write_hashes(folder)
    return folder


def configured(config: PolicyChartCommand, steps: int) -> ScoreConfig:
    """Return how the checkpoints are scored that execute so many steps."""
    sources = [
        shipped_checkpoint() if name == "shipped" else Path(name) for name in split(config.policy)
    ]
    folders = [
        executing(source, steps, Path(config.out) / "checkpoints" / f"{number}_{steps}")
        for number, source in enumerate(sources)
    ]
    return ScoreConfig(
        policy=",".join(map(str, folders)),
        arm=f"executes {steps}",
        right_sensor=config.right_sensor,
        rollouts=config.rollouts,
        first_seed=config.first_seed,
        videos=0,
        out=config.out,
    )


def point(report: ArmReport, steps: int, default: int) -> Point:
    """Return a point of the chart; a call of the policy is shared by the steps that it gives."""
    interval = wilson(sum(row.clean for row in report.rows), len(report.rows))
    cost = median(row.think_p50_ms for row in report.rows) / steps
    return Point(
        f"{steps} of 16",
        cost,
        interval.k / interval.n,
        interval.low,
        interval.high,
        steps == default,
    )


@command(PolicyChartCommand)
def main(config: PolicyChartCommand) -> None:
    """Entry of ``python -m benchmarks.charts.policy``."""
    reports = score_arms([configured(config, steps) for steps in EXECUTED], config.workers)
    first = shipped_checkpoint() if config.policy == "shipped" else Path(split(config.policy)[0])
    default = json.loads((first / "config.json").read_text())["n_action_steps"]
    points = [
        point(report, steps, default) for report, steps in zip(reports, EXECUTED, strict=True)
    ]
    path, title = Path(config.out) / "chart_policy.json", "steps executed of a chunk, simulated"
    cost, score = (
        f"ms of one core per control step of {CONTROL_ms:.0f} ms",
        "clean, development scenes, 95 % interval",
    )
    content = {"family": "policy"} | publish(points, path.with_suffix(".png"), title, cost, score)
    content["rows"] = {report.arm: report.as_dict() for report in reports}
    print(f"* on the front; written to {write_json(path, content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
