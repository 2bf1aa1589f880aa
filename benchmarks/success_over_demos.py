"""How many demos does an arm need? Its checkpoints of few and many demos on the same scenes."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from benchmarks.wiping_figures import draw_success_over_demos
from benchmarks.wiping_plan import ARMS, Arm
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from lerobot_policy_pi05_uniforce.controller import stored_config
from uniforce_cli.boundary import command
from uniforce_cli.option_types import Level
from uniforce_cli.score import score_arms
from uniforce_cli.score_config import SCRIPTS, ScoreConfig
from uniforce_vtla.arguments import choose, names_in
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.evaluation.arms import ArmReport
from uniforce_vtla.options import Count, FolderPaths, Names, OutFolder, Seed, Workers
from uniforce_vtla.results_file import provenance, write_json

LearnerArms = Annotated[
    str, Names(tuple(arm.name for arm in ARMS if arm.checkpoint not in SCRIPTS), many=True)
]


@dataclass
class SuccessOverDemosConfig:
    """Score an arm's checkpoints of few and many demos, trained by ``train_arm name=vt demos=5``, 12, ….

    Example: python -m benchmarks.success_over_demos checkpoints=outputs/arms/seed0 only=V+T,V rollouts=100
    """

    # folders (comma between them) of python -m benchmarks.train_arm's checkpoints: vt, vt_5demos, vt_12demos, …
    checkpoints: FolderPaths = "outputs/arms/seed0"
    only: LearnerArms = "V+T"  # arms of the plan (comma between them), each a curve
    level: Level = "paper"  # locked level
    rollouts: Count = 100  # paired seeds per checkpoint
    first_seed: Seed = 30_000  # the benchmark's scenes
    workers: Workers = 2  # processes, one torch thread each
    out: OutFolder = "outputs/success_over_demos"  # an episode per line and checkpoint; a killed run goes on
    results: OutFolder = "outputs/success_over_demos"  # success_over_demos.json and its picture


@dataclass(frozen=True)
class Point:
    """A checkpoint of an arm, and from how many demos it learnt."""

    arm: Arm
    checkpoint: Path
    demos: int


def points(config: SuccessOverDemosConfig) -> list[Point]:
    """Return the checkpoints found, each arm's from few to many demos.

    Raises:
        ContractError: an unknown arm.
        DatasetError: an arm that none of the folders has a checkpoint of.
    """
    learners = {arm.name: arm for arm in ARMS if arm.checkpoint not in SCRIPTS}
    folders = [Path(folder) for folder in names_in(config.checkpoints)]
    found: list[Point] = []
    for arm in choose(learners, config.only).values():
        names = (arm.checkpoint, f"{arm.checkpoint}_*demos")
        files = [file for folder in folders for name in names for file in folder.glob(f"{name}/config.json")]
        if not files:
            do = f"Train it: python -m benchmarks.train_arm name={arm.checkpoint} demos=12."
            raise DatasetError(expected(config.checkpoints, f"checkpoints of {arm.name}", "none", do))
        own = [Point(arm, file.parent, _demos(file.parent)) for file in files]
        found += sorted(own, key=lambda point: point.demos)
    return found


def _demos(checkpoint: Path) -> int:
    """Return from how many demos a checkpoint says that it learnt.

    Raises:
        DatasetError: it doesn't say.
    """
    told = stored_config(checkpoint).trained_on.get("episodes", "")
    if not told.isdigit():
        do = "Train it with python -m benchmarks.train_arm, which notes them."
        raise DatasetError(expected(f"trained_on of {checkpoint}", "a number of episodes", repr(told), do))
    return int(told)


def _scoring(config: SuccessOverDemosConfig, point: Point) -> ScoreConfig:
    return ScoreConfig(
        policy=str(point.checkpoint),
        arm=f"{point.arm.name} {point.demos} demos",
        level=config.level,
        left_sensor=point.arm.left,
        right_sensor=point.arm.right,
        swap=point.arm.swap,
        control=point.arm.control,
        rollouts=config.rollouts,
        first_seed=config.first_seed,
        videos=0,
        out=config.out,
    )


def report(config: SuccessOverDemosConfig, scored: Sequence[tuple[Point, ArmReport]]) -> Path:
    """Write the curves' figures and their picture; return the former's path."""
    path = Path(config.results) / "success_over_demos.json"
    curves: dict[str, dict[int, ArmReport]] = {}
    for point, arm in scored:
        curves.setdefault(point.arm.name, {})[point.demos] = arm
    content = {
        "what": "simulated; clean success = success without slippage or excess force; demos of all rigs together",
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "curves": {
            name: [{"demos": demos} | arm.as_dict() for demos, arm in curve.items()]
            for name, curve in curves.items()
        },
    }
    write_json(path, content | provenance())
    draw_success_over_demos(curves, path.with_suffix(".png"))
    return path


@command(SuccessOverDemosConfig)
def main(config: SuccessOverDemosConfig) -> int:
    """Entry of ``python -m benchmarks.success_over_demos``."""
    logging.basicConfig(level=logging.WARNING)
    found = points(config)
    reports = score_arms([_scoring(config, point) for point in found], config.workers)
    path = report(config, list(zip(found, reports, strict=True)))
    for arm in reports:
        print(f"{arm.arm:28s} clean {arm.count('clean')}/{arm.n}, wiped {arm.count('success')}")
    print(f"written to {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
