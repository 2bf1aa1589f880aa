"""Score a part of the plan: rows in turns on paired scenes, one table, one figure, and ``wiping.json``.

Claims and tests are of all rows of that file together: parts of one comparison may be scored one after the other.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from benchmarks.ladder.plan import BETTER, PARTS, Entry, claims
from benchmarks.scene_blocks import BLOCKS
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command
from uniforce_cli.score import check_policies, score_arms
from uniforce_cli.score_settings import SCRIPTS, ScoreConfig
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, table
from uniforce_vtla.evaluation.comparison import better
from uniforce_vtla.evaluation.pictures import draw_arms
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import (
    CountOrZero,
    FilePath,
    FolderPath,
    OutFile,
    OutFolder,
    Seed,
    Text,
    Workers,
)
from uniforce_vtla.results_file import provenance, write_json

DEMONSTRATED = {"left_sensor": "gelsight", "right_sensor": "tactip"}
CLEAN = "C"  # of EpisodeRow.code
CLAIMABLE = 200  # an arm of fewer rollouts stands aside: no claim rests on it
SECTIONS = {
    "grip": "ladder",
    "ladder": "ladder",
    "left_out": "ladder",
    "weighed": "ladder",
    "controls": "ladder_controls",
    "arms": "arms",
}
ROWS = ("arms", "side_arms", "ladder", "ladder_controls")  # sections of wiping.json that hold rows


@dataclass
class LadderCommand:
    """Roll out what the plan names and the checkpoints' folder holds; write wiping.json with the plan's claims.

    Example: python -m benchmarks.ladder part=ladder checkpoints=outputs/arms onto=docs/results/wiping.json
    """

    part: Literal["grip", "ladder", "left_out", "weighed", "controls", "arms"] = "ladder"
    checkpoints: FolderPath = "outputs/arms"  # ARM/seed0, ARM/seed1, …
    # of `uniforce calibrate`: shipped/uskin-2, …; "" = those rows wait
    calibrations: FolderPath = ""
    # names between commas: score these alone, the others wait; "" = all of the part
    rows: Text = ""
    level: Level = "touch"
    rollouts: CountOrZero = 0  # per sensor worn; 0 = as planned
    first_seed: Seed = 0  # 0 = the plan's own block: score it once
    workers: Workers = 2
    # gates.json of the arms' scenes (benchmarks.gates first_seed=…): its best script without touch stands beside them
    blind: FilePath = ""
    onto: FilePath = ""  # an earlier wiping.json that these rows are added to
    work: OutFolder = "outputs/ladder"  # episodes so far: run it again to go on
    out: OutFile = "outputs/wiping.json"  # its figure, of these rows alone, is named after the part


def score_config(entry: Entry, worn: str, **settings: Any) -> ScoreConfig:
    """Return how a row is scored with one of its sensors; ``settings`` are further fields of ``ScoreConfig``."""
    fingers: dict[str, Any] = DEMONSTRATED | {
        f"{entry.finger}_sensor": worn,
        "control": entry.control,
    }
    return ScoreConfig(
        **{
            "arm": entry.name,
            "swap": entry.swap,
            "grip": entry.grip,
            "videos": 0,
            **fingers,
            **settings,
        }
    )


def configured(config: LadderCommand, entry: Entry) -> list[ScoreConfig]:
    """Return how a row is scored, one part per sensor it wears; none where checkpoints or calibrations aren't there."""
    policy = entry.checkpoints
    if policy not in (*SCRIPTS, "shipped"):
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
        parts.append(
            score_config(entry, worn, policy=policy, out=config.work, **scenes, **calibration)
        )
    return parts


def joined(
    configs: Sequence[ScoreConfig], parts: Sequence[ArmReport]
) -> dict[str, tuple[ArmReport, list[str]]]:
    """Return each row's report over its parts, and clean k/n of each training seed: they take turns."""
    found: dict[str, tuple[list[EpisodeRow], dict[str, list[bool]]]] = {}
    for config, part in zip(configs, parts, strict=True):
        rows, by_policy = found.setdefault(
            config.arm, ([], {policy: [] for policy in config.policies})
        )
        rows += part.rows
        for row in part.rows:
            by_policy[config.policy_of(row.seed)].append(row.clean)
    return {
        name: (
            ArmReport(name, rows),
            [f"{sum(clean)}/{len(clean)}" for clean in by_policy.values()],
        )
        for name, (rows, by_policy) in found.items()
    }


def wanted(config: LadderCommand) -> list[Entry]:
    """Return the part's rows that are to be scored, in the plan's order; ContractError: a name it doesn't hold."""
    planned = {entry.name: entry for entry in PARTS[config.part]}
    chosen = choose(planned, config.rows, "rows")
    return [entry for name, entry in planned.items() if name in chosen]


def filed(part: str, level: str, rows: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return ``wiping.json`` of rows that were scored now, each under its section, without claims."""
    found: dict[str, Any] = {"level": level, "level_hash": level_hash(LEVELS[level])}
    found["scored_by"] = [{key: provenance()[key] for key in ("command", "date", "machine")}]
    found["training_seeds"] = max(len(row["clean_by_training_seed"]) for row in rows.values())
    found |= {section: {} for section in ROWS}
    section = SECTIONS[part]
    for name, row in rows.items():
        aside = section == "arms" and row["n"] < CLAIMABLE
        key = name.replace(" ", "_") if section == "ladder" else name
        found["side_arms" if aside else section][key] = row
    return found


def added(found: dict[str, Any], earlier: dict[str, Any]) -> dict[str, Any]:
    """Return an earlier report with these rows beside its own; ContractError: of another level."""
    level = ("level", "level_hash")
    if came := {key: earlier[key] for key in level if earlier[key] != found[key]}:
        wanted = {key: found[key] for key in came}
        raise ContractError(
            expected("level of the earlier report", wanted, came, "Score them on one level.")
        )
    rows = {section: earlier[section] | found[section] for section in ROWS}
    return earlier | rows | {"scored_by": earlier["scored_by"] + found["scored_by"]}


def _report(file: str, keys: Sequence[str]) -> dict[str, Any] | None:
    """Return an earlier result that holds ``keys``, None without a file; ContractError: another kind of file."""
    if not file:
        return None
    found = read_object(Path(file), ContractError)
    if missing := [key for key in keys if key not in found]:
        raise ContractError(
            expected(file, f"a result with {list(keys)}", f"no {missing}", "Is it another file?")
        )
    return found


def add_best_blind(found: dict[str, Any], gates: dict[str, Any]) -> None:
    """Put the script without touch that wipes clean most often beside the arms.

    Raises ContractError: another level or other scenes than V+T's.
    """
    scored, with_touch = [gates["level_hash"], *gates["seeds"]], found["arms"]["V+T"]
    wanted = [found["level_hash"], *with_touch["seeds"]]
    if scored != wanted:
        raise ContractError(
            expected(
                "level and scenes of the blind", wanted, scored, "Run them on the arms' scenes."
            )
        )
    blind = gates["must_fail"]
    name = max(blind, key=lambda name: blind[name]["clean"])
    found["arms"]["best blind"] = {"script": name, "seeds": gates["seeds"], **blind[name]}


def named_rows(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each row of every section under its name in the plan; arms and side arms may share one."""
    for section in ROWS:
        for key, row in found[section].items():
            yield key.replace("_", " "), row


def codes(row: dict[str, Any]) -> dict[int, str]:
    """Return the code of how each rollout of a row ended, by its scene's seed."""
    first, last = row["seeds"]
    return dict(zip(range(first, last + 1), row["by_seed"], strict=True))


def clean_by_seed(found: dict[str, Any]) -> dict[str, dict[int, bool]]:
    """Return whether each rollout was clean, by the row's name in the plan and the scene's seed."""
    arms: dict[str, dict[int, bool]] = {}
    for name, row in named_rows(found):
        arms.setdefault(name, {}).update({seed: code == CLEAN for seed, code in codes(row).items()})
    return arms


def judged(found: dict[str, Any]) -> dict[str, Any]:
    """Return the report with the plan's claims and tests, each of the scenes that both of its rows share."""
    arms = clean_by_seed(found)
    return found | {"within": claims(arms), "tests": better(arms, BETTER)}


@command(LadderCommand)
def main(config: LadderCommand) -> None:
    planned = [(entry, configured(config, entry)) for entry in wanted(config)]
    configs = [part for _, parts in planned for part in parts]
    earlier = _report(config.onto, ("level", "level_hash", "scored_by", *ROWS))
    gates = _report(config.blind, ("level_hash", "seeds", "must_fail"))
    if not configs:
        do = "Train arms into it: uniforce train … output_dir=…, then link ARM/seed0 to pretrained_model."
        came = f"none, or no calibrations for them in {config.calibrations!r}"
        raise CheckpointError(expected(config.checkpoints, "checkpoints of the plan", came, do))
    for entry, parts in planned:
        if not parts:
            print(
                f"not scored: {entry.name} (no {entry.checkpoints} or no calibration of {entry.worn} there)"
            )
    for one in configs:
        check_policies(one)
    found = joined(configs, score_arms(configs, config.workers))
    reports = {name: report for name, (report, _) in found.items()}
    rows = {
        name: report.as_dict() | {"clean_by_training_seed": seeds}
        for name, (report, seeds) in found.items()
    }
    content = filed(config.part, config.level, rows)
    if earlier is not None:
        content = added(content, earlier)
    if gates is not None:
        add_best_blind(content, gates)
    content = judged(content)
    print(table(list(reports.values())))
    for name, row in rows.items():
        seeds = " ".join(row["clean_by_training_seed"])
        print(
            f"{name:28} {wilson(row['clean'], row['n'])}  share {row['in_band_share']:.2f}  training seeds {seeds}"
        )
    for claim in content["within"]:
        said = f"{100 * claim['difference']:+.0f} points, bound {100 * claim['lower']:+.0f}"
        print(
            f"{' against '.join(claim['arms'])}: {said}, {'within' if claim['holds'] else 'NOT within'}"
        )
    path = write_json(Path(config.out), content | provenance())
    figure = path.with_name(f"{path.stem}_{config.part}.png")
    draw_arms(
        list(reports.values()), figure, title=f"{config.part}, level {config.level}, simulated"
    )
    print(f"written to {path} and {figure}")


if __name__ == "__main__":
    sys.exit(main())
