"""Score the plan: rows in turns on the same scenes, one table, one result file."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.calibrations import KNOWN, calibration_folder
from benchmarks.ladder.comparison import as_good, better
from benchmarks.ladder.plan import (
    BETTER,
    CLAIMS,
    GRIPPER,
    LADDER,
    LEVEL,
    SLACK,
    Row,
)
from benchmarks.scene_blocks import BLOCKS
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import command, one_thread
from uniforce_cli.score import check_policies, score_arms
from uniforce_cli.score_settings import ScoreConfig
from uniforce_vtla.arguments import choose
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.evaluation.arms import ArmReport, CleanBySeed, EpisodeRow, table
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import FolderPath, OutFile, OutFolder, Text, Workers
from uniforce_vtla.results_file import provenance, write_json


@dataclass
class LadderCommand:
    """Roll out what the plan names and the checkpoints' folder holds; write the result.

    Example: python -m benchmarks.ladder rows=S0,S1
    """

    checkpoints: FolderPath = "benchmarks/ladder/checkpoints"  # latent/seed0, latent/seed1, …
    rows: Text = ""  # names between commas: score these alone; "" = all
    workers: Workers = 2
    # calibrations, and episodes so far: run it again to go on
    work: OutFolder = "outputs/ladder"
    out: OutFile = "outputs/swap.json"  # the result file


def _calibration(config: LadderCommand, row: Row, finger: Finger, worn: str) -> str:
    """Return the folder of a finger's calibration; "" where a row asks for none."""
    if not row.fit or worn == KNOWN[finger]:
        return ""
    return str(calibration_folder(worn, row.fit, Path(config.work), finger))


def configured(config: LadderCommand, row: Row) -> list[ScoreConfig]:
    """Return how a row is scored, a part per sensor; none without checkpoints."""
    policies = sorted(Path(config.checkpoints).glob(row.policy))
    if not policies:
        return []
    share = row.rollouts // len(row.worn)
    first = BLOCKS["swap ladder in the hand's rig"].start
    parts = []
    lefts = row.left or (KNOWN["left"],) * len(row.worn)
    for left, worn in zip(lefts, row.worn, strict=True):
        parts.append(
            ScoreConfig(
                policy=",".join(map(str, policies)),
                arm=row.name,
                level=LEVEL,
                left_sensor=left,
                left_calibration=_calibration(config, row, "left", left),
                right_sensor=worn,
                right_calibration=_calibration(config, row, "right", worn),
                gripper=GRIPPER,
                control=row.control,
                first_seed=first,
                rollouts=share,
                videos=0,
                out=config.work,
            )
        )
        first += share
    return parts


def joined(configs: Sequence[ScoreConfig], parts: Sequence[ArmReport]) -> dict[str, dict[str, Any]]:
    """Return each row's figures over its parts, with clean k/n of each training seed."""
    rows: dict[str, list[EpisodeRow]] = {}
    by_policy: dict[str, dict[str, list[bool]]] = {}
    for config, part in zip(configs, parts, strict=True):
        rows.setdefault(config.arm, []).extend(part.rows)
        clean = by_policy.setdefault(config.arm, {})
        for row in part.rows:
            clean.setdefault(Path(config.policy_of(row.seed)).name, []).append(row.clean)
    found = {}
    for name, own in rows.items():
        seeds = {}
        for seed, ended in sorted(by_policy[name].items()):
            seeds[seed] = f"{sum(ended)}/{len(ended)}"
        found[name] = ArmReport(name, own).as_dict() | {"clean_by_training_seed": seeds}
    return found


def clean_by_scene(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, CleanBySeed]:
    """Return by row and scene whether the rollout was clean."""
    found: dict[str, CleanBySeed] = {}
    for name, row in rows.items():
        scenes = range(row["seeds"][0], row["seeds"][1] + 1)
        found[name] = {
            scene: code == "C" for scene, code in zip(scenes, row["by_seed"], strict=True)
        }
    return found


def claims(rows: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the plan's claims with their verdict: estimate in the margin, bound in the slack."""
    found = as_good(clean_by_scene(rows), CLAIMS)
    for claim in found:
        in_margin = claim["difference"] >= -claim["margin"]
        claim["holds"] = bool(in_margin and claim["lower"] >= -claim["margin"] - SLACK)
    return found


def earlier_rows(config: LadderCommand) -> dict[str, dict[str, Any]]:
    """Return the rows that an earlier run wrote."""
    path = Path(config.out)
    if not path.is_file():
        return {}
    rows: dict[str, dict[str, Any]] = read_object(path, ContractError).get("rows", {})
    return rows


def scored(config: LadderCommand) -> dict[str, dict[str, Any]]:
    """Score the rows whose checkpoints are there; return their figures by name.

    Raises CheckpointError: there are none for any row.
    """
    configs = []
    planned = {row.name: row for row in LADDER}
    chosen = choose(planned, config.rows, "rows")
    for name, row in planned.items():
        if name not in chosen:
            continue
        parts = configured(config, row)
        configs += parts
        if not parts:
            print(f"not scored: {name} (no {row.policy} in {config.checkpoints})")
    if not configs:
        do = "Train them into it, as docs/experiments/swap.md says."
        raise CheckpointError(
            expected(config.checkpoints, "checkpoints of the plan", "none of these rows", do)
        )
    for one in configs:
        check_policies(one)
    reports = score_arms(configs, config.workers)
    print(table(reports))
    return joined(configs, reports)


@command(LadderCommand)
def main(config: LadderCommand) -> None:
    one_thread()
    rows = earlier_rows(config) | scored(config)
    content: dict[str, Any] = {"level": LEVEL, "level_hash": level_hash(LEVELS[LEVEL])}
    content |= {"gripper": GRIPPER, "rows": rows, "within": claims(rows)}
    content["tests"] = better(clean_by_scene(rows), BETTER)
    for name, row in rows.items():
        by_seed = " ".join(row["clean_by_training_seed"].values())
        print(f"{name:34} {wilson(row['clean'], row['n'])}  training seeds {by_seed}")
    for claim in content["within"]:
        said = f"{100 * claim['difference']:+.0f} points, bound {100 * claim['lower']:+.0f}"
        verdict = "within" if claim["holds"] else "NOT within"
        print(f"{' against '.join(claim['arms'])}: {said}, {verdict}")
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
