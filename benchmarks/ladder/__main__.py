"""Score a part of the plan: rows in turns on paired scenes, one table, one figure, ``wiping.json``.

Claims and tests are of all rows of that file together: parts of one comparison may be scored one
after the other.
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
    """Roll out what the plan names and the checkpoints' folder holds; write wiping.json.

    Example: python -m benchmarks.ladder part=ladder checkpoints=outputs/arms onto=old/wiping.json
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
    # gates.json of the arms' scenes (benchmarks.gates first_seed=…): its best script without touch
    # stands beside them
    blind: FilePath = ""
    onto: FilePath = ""  # an earlier wiping.json that these rows are added to
    work: OutFolder = "outputs/ladder"  # episodes so far: run it again to go on
    out: OutFile = "outputs/wiping.json"  # its figure, of these rows alone, is named after the part


def score_config(entry: Entry, worn: str, **settings: Any) -> ScoreConfig:
    """Return how a row is scored with one of its sensors; ``settings``: further fields."""
    fields: dict[str, Any] = {
        "arm": entry.name,
        "swap": entry.swap,
        "grip": entry.grip,
        "control": entry.control,
        "videos": 0,
        **DEMONSTRATED,
        f"{entry.finger}_sensor": worn,
    }
    return ScoreConfig(**fields | settings)


def configured(config: LadderCommand, entry: Entry) -> list[ScoreConfig]:
    """Return how a row is scored, a part per sensor; none without checkpoints or calibrations."""
    policy = entry.checkpoints
    if policy not in (*SCRIPTS, "shipped"):
        policy = ",".join(map(str, sorted(Path(config.checkpoints, policy).glob("seed*"))))
    if not policy:
        return []
    share = entry.rollouts // len(entry.worn)
    if config.rollouts:
        share = min(share, config.rollouts)
    first = config.first_seed or BLOCKS[entry.block].start
    parts = []
    for worn in entry.worn:
        scenes: dict[str, Any] = {
            "level": config.level,
            "first_seed": first,
            "rollouts": share,
        }
        if entry.calibrated:
            folder = Path(config.calibrations, entry.tokenizer, worn.replace(":", "-"))
            if not config.calibrations or not folder.is_dir():
                return []
            scenes[f"{entry.finger}_calibration"] = str(folder)
        parts.append(score_config(entry, worn, policy=policy, out=config.work, **scenes))
        first += share
    return parts


def joined(
    configs: Sequence[ScoreConfig], parts: Sequence[ArmReport]
) -> dict[str, tuple[ArmReport, list[str]]]:
    """Return each row's report over its parts, and clean k/n of each training seed."""
    rows: dict[str, list[EpisodeRow]] = {}
    clean: dict[str, dict[str, list[bool]]] = {}
    for config, part in zip(configs, parts, strict=True):
        rows.setdefault(config.arm, []).extend(part.rows)
        by_policy = clean.setdefault(config.arm, {policy: [] for policy in config.policies})
        for row in part.rows:
            by_policy[config.policy_of(row.seed)].append(row.clean)
    found = {}
    for name, own_rows in rows.items():
        found[name] = (
            ArmReport(name, own_rows),
            [f"{sum(own)}/{len(own)}" for own in clean[name].values()],
        )
    return found


def wanted(config: LadderCommand) -> list[Entry]:
    """Return the part's rows to score, in the plan's order; ContractError: a name it lacks."""
    planned = {entry.name: entry for entry in PARTS[config.part]}
    chosen = choose(planned, config.rows, "rows")
    return [entry for name, entry in planned.items() if name in chosen]


def filed(part: str, level: str, rows: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return ``wiping.json`` of rows that were scored now, under their section, without claims."""
    made = provenance()
    found: dict[str, Any] = {
        "level": level,
        "level_hash": level_hash(LEVELS[level]),
        "scored_by": [{key: made[key] for key in ("command", "date", "machine")}],
        "training_seeds": max(len(row["clean_by_training_seed"]) for row in rows.values()),
    }
    for section in ROWS:
        found[section] = {}
    section = SECTIONS[part]
    for name, row in rows.items():
        if section == "ladder":
            found[section][name.replace(" ", "_")] = row
        elif section == "arms" and row["n"] < CLAIMABLE:
            found["side_arms"][name] = row
        else:
            found[section][name] = row
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
    """Return an earlier result that holds ``keys``, None without a file; ContractError: another."""
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
    scored = [gates["level_hash"], *gates["seeds"]]
    wanted = [found["level_hash"], *found["arms"]["V+T"]["seeds"]]
    if scored != wanted:
        do = "Run them on the arms' scenes."
        raise ContractError(expected("level and scenes of the blind", wanted, scored, do))
    blind = gates["must_fail"]
    name = max(blind, key=lambda name: blind[name]["clean"])
    found["arms"]["best blind"] = {"script": name, "seeds": gates["seeds"], **blind[name]}


def named_rows(found: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each row of every section by its name in the plan; arms and side arms may share one."""
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
        own = arms.setdefault(name, {})
        for seed, code in codes(row).items():
            own[seed] = code == CLEAN
    return arms


def judged(found: dict[str, Any]) -> dict[str, Any]:
    """Return the report with the plan's claims and tests, of scenes that both rows share."""
    arms = clean_by_seed(found)
    return found | {"within": claims(arms), "tests": better(arms, BETTER)}


@command(LadderCommand)
def main(config: LadderCommand) -> None:
    earlier = _report(config.onto, ("level", "level_hash", "scored_by", *ROWS))
    gates = _report(config.blind, ("level_hash", "seeds", "must_fail"))
    configs = []
    for entry in wanted(config):
        parts = configured(config, entry)
        configs += parts
        if not parts:
            lacks = f"no {entry.checkpoints} or no calibration of {entry.worn} there"
            print(f"not scored: {entry.name} ({lacks})")
    if not configs:
        do = (
            "Train arms into it: uniforce train … output_dir=…, "
            "then link ARM/seed0 to pretrained_model."
        )
        came = f"none, or no calibrations for them in {config.calibrations!r}"
        raise CheckpointError(expected(config.checkpoints, "checkpoints of the plan", came, do))
    for one in configs:
        check_policies(one)
    reports = []
    rows = {}
    for name, (report, seeds) in joined(configs, score_arms(configs, config.workers)).items():
        reports.append(report)
        rows[name] = report.as_dict() | {"clean_by_training_seed": seeds}
    content = filed(config.part, config.level, rows)
    if earlier is not None:
        content = added(content, earlier)
    if gates is not None:
        add_best_blind(content, gates)
    content = judged(content)
    print(table(reports))
    for name, row in rows.items():
        by_seed = " ".join(row["clean_by_training_seed"])
        share = f"share {row['in_band_share']:.2f}  training seeds {by_seed}"
        print(f"{name:28} {wilson(row['clean'], row['n'])}  {share}")
    for claim in content["within"]:
        said = f"{100 * claim['difference']:+.0f} points, bound {100 * claim['lower']:+.0f}"
        verdict = "within" if claim["holds"] else "NOT within"
        print(f"{' against '.join(claim['arms'])}: {said}, {verdict}")
    path = write_json(Path(config.out), content | provenance())
    figure = path.with_name(f"{path.stem}_{config.part}.png")
    draw_arms(reports, figure, title=f"{config.part}, level {config.level}, simulated")
    print(f"written to {path} and {figure}")


if __name__ == "__main__":
    sys.exit(main())
