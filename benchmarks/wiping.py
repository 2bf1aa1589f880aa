"""The wiping benchmark: all arms on paired seeds, in turns, with the plan's tests; or a replay of its table."""

import json
import logging
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.wiping_plan import ARMS, AS_GOOD, BETTER, Arm
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command
from uniforce_cli.score import SCRIPTS, ScoreConfig, check_film, score_arms
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.evaluation.arms import ArmReport, own_scenes, table, whose_turn
from uniforce_vtla.evaluation.comparison import as_good, better
from uniforce_vtla.evaluation.pictures import PICTURE_DPI, draw_arms
from uniforce_vtla.figure_file import save_figure
from uniforce_vtla.options import (
    Count,
    CountOrZero,
    FolderPaths,
    Names,
    OutFolder,
    Seed,
    Seeds,
    Workers,
    split,
)
from uniforce_vtla.results_file import provenance, write_json

PANELS_PER_ROW = 6  # z-profiles that still fit a page
Z_RANGE_MM = (-4.0, 6.0)  # what pressing changes; a look back lifts out of it
PlanArms = Annotated[str, Names(tuple(arm.name for arm in ARMS), many=True)]


@dataclass
class BenchmarkConfig:
    """Score every arm of the plan whose checkpoint is there; a killed run goes on with what is missing.

    Example: python -m benchmarks.wiping rollouts=200
    or, against the published table: python -m benchmarks.wiping replay=5 results=docs/results
    or, of your own arms: python -m benchmarks.wiping checkpoints=outputs/arms/seed0 results=outputs/benchmark_results
    """

    # holds a folder per checkpoint of wiping_plan.py; these come with the source. Several (comma between them), one for
    # each training seed, take turns from scene to scene, the same for all arms
    checkpoints: FolderPaths = "checkpoints/wiping/seed0"
    level: Level = "paper"  # locked level
    only: PlanArms = ""  # names of arms (comma between them); empty = all that have a checkpoint
    rollouts: Count = 200  # paired seeds per arm; ≥ 200 for claims
    # never recorded from, nor looked at while settings were chosen, as some from 10,000 and 20,000 on
    first_seed: Seed = 30_000
    workers: Workers = 2  # processes, one torch thread each
    videos: CountOrZero = 1  # episodes filmed per arm, the first ones
    film: Seeds = field(default_factory=list)  # seeds filmed besides; rolled out again where scored unfilmed
    out: OutFolder = "outputs/benchmark"  # an episode per line and arm, sheets and videos
    # wiping.json and its pictures; of replay: where the table is read
    results: OutFolder = "outputs/benchmark"
    replay: CountOrZero = 0  # only roll so many seeds out again and compare them with the committed table


def configs(command: BenchmarkConfig, rollouts: int) -> list[ScoreConfig]:
    """Return what to score, in the plan's order.

    Raises:
        ContractError: an unknown arm.
        DatasetError: none of the arms has a checkpoint.
    """
    found = []
    for arm in choose({arm.name: arm for arm in ARMS}, command.only).values():
        policy = _policy(command, arm)
        if policy:
            found.append(_config(command, arm, policy, rollouts))
        else:
            print(f"left out: {arm.name} (no checkpoint {arm.checkpoint} in {command.checkpoints})")
    if not found:
        do = "Train the arms (python -m benchmarks.train_arm), or name their folder with checkpoints=."
        raise DatasetError(expected(command.checkpoints, "a checkpoint of the plan", "none", do))
    return found


def _policy(command: BenchmarkConfig, arm: Arm) -> str:
    """Return what the scorer calls the arm's policy; empty where there is none."""
    if arm.checkpoint in SCRIPTS:
        return arm.checkpoint
    folders = [Path(seed) / arm.checkpoint for seed in split(command.checkpoints)]
    return ",".join(map(str, folders)) if all((f / "config.json").exists() for f in folders) else ""


def _config(command: BenchmarkConfig, arm: Arm, policy: str, rollouts: int) -> ScoreConfig:
    return ScoreConfig(
        policy=policy,
        arm=arm.name,
        level=command.level,
        left_sensor=arm.left,
        right_sensor=arm.right,
        swap=arm.swap,
        control=arm.control,
        rollouts=rollouts,
        first_seed=command.first_seed,
        videos=command.videos,
        film=command.film,
        out=command.out,
    )


def report(command: BenchmarkConfig, reports: Sequence[ArmReport], seconds: float) -> Path:
    """Write the table, the plan's tests and the pictures; other keys of an earlier table are kept."""
    path = Path(command.results) / "wiping.json"
    by_name, planned = {r.arm: r for r in reports}, {arm.name: arm.checkpoint for arm in ARMS}
    earlier = json.loads(path.read_text()) if path.exists() else {}
    kept = {"blind_scripts": earlier["blind_scripts"]} if _same_level(earlier, command.level) else {}
    content: dict[str, Any] = {
        "what": "simulated; clean success = success without slippage or excess force",
        "level": command.level,
        "level_hash": level_hash(LEVELS[command.level]),
        "checkpoints": split(command.checkpoints),
        "arms": {r.arm: {"checkpoint": planned[r.arm]} | r.as_dict() | _by_checkpoint(r, command) for r in reports},
        "tests": better(by_name, BETTER),
        "as_good": as_good(by_name, AS_GOOD),
        "seconds_of_last_call": seconds,  # a resumed table was rolled out in several
    }
    write_json(path, kept | content | provenance())
    draw_arms(reports, path.with_suffix(".png"), title=f"wiping, level {command.level}, simulated")
    draw_z_profiles(reports, path.with_name("wiping_z.png"))
    return path


def draw_z_profiles(reports: Sequence[ArmReport], path: Path) -> Path:
    """Draw each arm's tool height over the wipe: median, and the middle half of all rollouts as a band.

    A board's height and tilt differ between scenes, so every profile is taken against its own median; medians, since
    a policy that looks back at the board lifts by centimetres between two sweeps.
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


def _by_checkpoint(arm: ArmReport, command: BenchmarkConfig) -> dict[str, Any]:
    """Return the clean rollouts of each training seed, where they took turns."""
    seeds = split(command.checkpoints)
    if len(seeds) == 1:
        return {}
    by_seed = arm.as_dict()["by_seed"]
    turns = [own_scenes(by_seed, seed, seeds) for seed in seeds]
    return {"clean_by_checkpoint": [f"{own['clean']}/{own['n']}" for own in turns]}


def _same_level(earlier: dict[str, Any], level: str) -> bool:
    return "blind_scripts" in earlier and earlier.get("level_hash") == level_hash(LEVELS[level])


def replay(command: BenchmarkConfig) -> str:
    """Roll the table's first seeds out again into a folder of their own; say on how many the outcome differs.

    Where training seeds took turns, a scene is compared if the checkpoint whose turn it was is here.
    """
    path = Path(command.results) / "wiping.json"
    if not path.exists():
        raise DatasetError(expected(str(path), "a committed table", "no such file", "Run the benchmark first."))
    committed = json.loads(path.read_text())
    command.out, command.level = f"{command.out}_replay", committed["level"]
    wanted = [c for c in configs(command, command.replay) if c.arm in committed["arms"]]
    for config in wanted:
        config.resume = False  # an earlier replay proves nothing about this one
        config.first_seed = committed["arms"][config.arm]["seeds"][0]
    seeds, here = committed["checkpoints"], split(command.checkpoints)
    own = [scene for scene in range(command.replay) if whose_turn(scene, seeds) in here]
    if not own and any(config.policy not in SCRIPTS for config in wanted):
        do = "Name those of the table."
        raise DatasetError(expected("checkpoints to replay", " | ".join(seeds), command.checkpoints, do))
    differing, compared, lines = 0, 0, []
    for config, again in zip(wanted, score_arms(wanted, command.workers), strict=True):
        scenes = range(command.replay) if config.policy in SCRIPTS else own
        before = "".join(committed["arms"][again.arm]["by_seed"][scene] for scene in scenes)
        now = "".join(again.rows[scene].code for scene in scenes)
        differing += sum(a != b for a, b in zip(before, now, strict=True))
        compared += len(now)
        lines.append(f"{again.arm:24s} committed {before}  now {now}")
    verdict = f"{differing} of {compared} episodes differ from {path}"
    return "\n".join([*lines, verdict])


def _run(command: BenchmarkConfig) -> str:
    if command.replay:
        return replay(command)
    start = time.perf_counter()
    check_film(command.film, range(command.first_seed, command.first_seed + command.rollouts))
    reports = score_arms(configs(command, command.rollouts), command.workers)
    path = report(command, reports, time.perf_counter() - start)
    return f"{table(reports)}\ntable, tests and figures: {path}"


@command(BenchmarkConfig)
def main(config: BenchmarkConfig) -> None:
    """Entry of ``python -m benchmarks.wiping``."""
    logging.basicConfig(level=logging.WARNING)
    print(_run(config))


if __name__ == "__main__":
    sys.exit(main())
