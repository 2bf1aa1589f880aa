"""Score a part of the plan: rows in turns on paired scenes, claims, one table, one figure."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from benchmarks.ladder.plan import BETTER, PARTS, Entry, claims
from benchmarks.scene_blocks import BLOCKS
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command
from uniforce_cli.score import check_policies, score_arms
from uniforce_cli.score_settings import SCRIPTS, ScoreConfig
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, table
from uniforce_vtla.evaluation.comparison import better
from uniforce_vtla.evaluation.pictures import draw_arms
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.options import CountOrZero, FolderPath, OutFile, OutFolder, Seed, Text, Workers
from uniforce_vtla.results_file import provenance, write_json

DEMONSTRATED = {"left_sensor": "gelsight", "right_sensor": "tactip"}


@dataclass
class LadderCommand:
    """Roll out what the plan names and the checkpoints' folder holds; test the plan's claims.

    Example: python -m benchmarks.ladder part=ladder checkpoints=outputs/arms
    """

    part: Literal["ladder", "left_out", "controls", "arms"] = "ladder"
    checkpoints: FolderPath = "outputs/arms"  # ARM/seed0, ARM/seed1, …
    calibrations: FolderPath = ""  # of `uniforce calibrate`: shipped/uskin-2, …; "" = those rows wait
    rows: Text = ""  # names between commas: score these alone, the others wait; "" = all of the part
    level: Level = "touch"
    rollouts: CountOrZero = 0  # per sensor worn; 0 = as planned
    first_seed: Seed = 0  # 0 = the plan's own block: score it once
    workers: Workers = 2
    work: OutFolder = "outputs/ladder"  # episodes so far: run it again to go on
    out: OutFile = "outputs/ladder.json"


def score_config(entry: Entry, worn: str, **settings: Any) -> ScoreConfig:
    """Return how a row is scored with one of its sensors; ``settings`` are further fields of ``ScoreConfig``."""
    fingers: dict[str, Any] = DEMONSTRATED | {f"{entry.finger}_sensor": worn, "control": entry.control}
    return ScoreConfig(**{"arm": entry.name, "swap": entry.swap, "videos": 0, **fingers, **settings})


def configured(config: LadderCommand, entry: Entry) -> list[ScoreConfig]:
    """Return how a row is scored, one part per sensor it wears; none where checkpoints or calibrations aren't there."""
    policy = entry.checkpoints
    if policy not in SCRIPTS:
        seeds = sorted(Path(config.checkpoints, policy).glob("seed*"))
        policy = ",".join(str(seed) for seed in seeds)
    folder = Path(config.calibrations, entry.tokenizer)
    maps = [folder / worn.replace(":", "-") for worn in entry.worn if entry.calibrated]
    if not policy or not all(config.calibrations and found.is_dir() for found in maps):
        return []
    first, share = config.first_seed or BLOCKS[entry.block].start, entry.rollouts // len(entry.worn)
    share = min(share, config.rollouts) if config.rollouts else share
    parts = []
    for number, worn in enumerate(entry.worn):
        calibration = {f"{entry.finger}_calibration": str(maps[number])} if maps else {}
        scenes = {"level": config.level, "first_seed": first + number * share, "rollouts": share}
        parts.append(score_config(entry, worn, policy=policy, out=config.work, **scenes, **calibration))
    return parts


def joined(configs: Sequence[ScoreConfig], parts: Sequence[ArmReport]) -> dict[str, tuple[ArmReport, list[str]]]:
    """Return each row's report over its parts, and clean k/n of each training seed: they take turns."""
    found: dict[str, tuple[list[EpisodeRow], dict[str, list[bool]]]] = {}
    for config, part in zip(configs, parts, strict=True):
        rows, by_policy = found.setdefault(config.arm, ([], {policy: [] for policy in config.policies}))
        rows += part.rows
        for row in part.rows:
            by_policy[config.policy_of(row.seed)].append(row.clean)
    return {
        name: (ArmReport(name, rows), [f"{sum(clean)}/{len(clean)}" for clean in by_policy.values()])
        for name, (rows, by_policy) in found.items()
    }


def wanted(config: LadderCommand) -> list[Entry]:
    """Return the part's rows that are to be scored, in the plan's order; ContractError: a name it doesn't hold."""
    planned = {entry.name: entry for entry in PARTS[config.part]}
    chosen = choose(planned, config.rows, "rows")
    return [entry for name, entry in planned.items() if name in chosen]


@command(LadderCommand)
def main(config: LadderCommand) -> None:
    planned = [(entry, configured(config, entry)) for entry in wanted(config)]
    configs = [part for _, parts in planned for part in parts]
    for entry, parts in planned:
        if not parts:
            print(f"not scored: {entry.name} (no {entry.checkpoints} or no calibration of {entry.worn} there)")
    if not configs:
        do = "Train arms into it: uniforce train … output_dir=…, then link ARM/seed0 to pretrained_model."
        raise CheckpointError(expected(config.checkpoints, "checkpoints of the plan", "none", do))
    for one in configs:
        check_policies(one)
    found = joined(configs, score_arms(configs, config.workers))
    reports = {name: report for name, (report, _) in found.items()}
    rows = {name: report.as_dict() | {"clean_by_training_seed": seeds} for name, (report, seeds) in found.items()}
    arms = {name: report.clean_by_seed for name, report in reports.items()}
    within = claims(arms)
    content = {
        "part": config.part,
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "plan": [asdict(entry) for entry, _ in planned],
        "rows": rows,
        "within": within,
        "better": better(arms, BETTER),
    }
    print(table(list(reports.values())))
    for name, row in rows.items():
        seeds = " ".join(row["clean_by_training_seed"])
        print(f"{name:28} {wilson(row['clean'], row['n'])}  share {row['in_band_share']:.2f}  training seeds {seeds}")
    for claim in within:
        said = f"{100 * claim['difference']:+.0f} points, bound {100 * claim['lower']:+.0f}"
        print(f"{' against '.join(claim['arms'])}: {said}, {'within' if claim['holds'] else 'NOT within'}")
    path = write_json(Path(config.out), content | provenance())
    draw_arms(list(reports.values()), path.with_suffix(".png"), title=f"{config.part}, level {config.level}, simulated")
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
