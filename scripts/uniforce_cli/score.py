"""Score a policy in the wiping scene: paired seeds, outcomes, events, intervals, a picture."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uniforce_cli.boundary import command
from uniforce_cli.score_settings import SCRIPTS, ScoreConfig, checkpoint_of
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.file_hashes import loaded_hash
from uniforce_vtla.json_file import read_object
from uniforce_vtla.results_file import append_line, only_writer, provenance, write_json

if TYPE_CHECKING:
    from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow

logger = logging.getLogger(__name__)
ROWS = "episodes.jsonl"
SETTINGS = "config.json"


def score(config: ScoreConfig) -> ArmReport:
    """Score ``config.rollouts`` seeds; finished episodes survive a kill and are not repeated."""
    check_policies(config)
    _check_name(config)
    return score_arms([config], config.workers)[0]


def check_policies(config: ScoreConfig) -> None:
    """Refuse unknown sensors or faults, another unit's calibration, and damaged checkpoints.

    Called before processes start.
    """
    from uniforce_vtla.tokenizer.weights import read_config

    _ = config.rig.kinds
    for finger, folder in config.rig.calibrations.items():
        fitted_to = str(read_config(Path(folder)).get("new", ""))
        mounted = _unit(config.rig.mounted[finger])
        if _unit(fitted_to) != mounted:
            do = f"Calibrate it: uniforce calibrate new={mounted}"
            option = f"{finger}_calibration"
            raise ContractError(expected(option, f"one of {mounted}", f"one of {fitted_to}", do))
    from lerobot_policy_pi05_uniforce.controller import stored_config

    for policy in {*config.policies} - {*SCRIPTS}:
        settings = stored_config(checkpoint_of(policy))
        settings.swap = config.swap or settings.swap
        settings.finger_by_slot()


def _check_name(config: ScoreConfig) -> None:
    """Refuse a name that another rig's arm of this level has in the same table."""
    for rows in Path(config.out).glob(f"*/{ROWS}"):
        settings = _settings(rows.parent)
        is_named_so = (settings["arm"], settings["level"]) == (config.arm, config.level)
        if is_named_so and rows.parent != config.folder:
            do = "Give arm=… another name."
            came = f"the name of {rows.parent}"
            raise ContractError(expected(f"arm={config.arm}", "a name of its own", came, do))


def _settings(folder: Path) -> dict[str, Any]:
    """Return the settings of an arm that was scored into this folder."""
    return read_object(folder / SETTINGS, ContractError)


def _unit(words: str) -> str:
    """Return the unit in a sensor's words, without faults: they come after its calibration."""
    name, _, which = words.partition("+")[0].partition(":")
    return f"{name}:{which or 1}"


def score_arms(configs: Sequence[ScoreConfig], workers: int) -> list[ArmReport]:
    """Score several arms in turns, seed by seed, so that a killed run has paired seeds of all.

    Each episode is forced to disk when it ends; the next call goes on with what is missing.
    Rollouts run on joblib's active backend, its own processes unless ``joblib.parallel_config``
    names another.

    Raises ContractError: a seed to be filmed isn't scored; ``out`` holds episodes of another policy
    or calibration; or another process scores into it now.
    """
    for config in configs:
        unscored = sorted(set(config.film) - set(config.seeds))
        if unscored:
            wanted = f"seeds {config.seeds[0]}…{config.seeds[-1]}"
            do = "Film what is scored: set first_seed and rollouts."
            raise ContractError(expected("film", wanted, unscored, do))
    with ExitStack() as held:
        for folder in dict.fromkeys(config.folder for config in configs):
            held.enter_context(only_writer(folder / ROWS))
        return _score_missing(configs, workers)


def _score_missing(configs: Sequence[ScoreConfig], workers: int) -> list[ArmReport]:
    from joblib import Parallel, delayed
    from tqdm import tqdm

    from uniforce_cli.score_worker import score_job
    from uniforce_vtla.evaluation.arms import ArmReport

    done = [_start(config) for config in configs]
    missing = []
    for index, config in enumerate(configs):
        for seed in config.seeds:
            unfilmed = seed in config.film and not config.video(seed).exists()
            if seed not in done[index] or unfilmed:
                missing.append((seed, index))
    missing.sort()  # all arms' first seeds first
    jobs = [delayed(score_job)(index, configs[index], seed) for seed, index in missing]
    label = configs[0].arm if len(configs) == 1 else f"{len(configs)} arms"
    pool = Parallel(max(1, min(workers, len(jobs))), return_as="generator_unordered", batch_size=1)
    bar = tqdm(pool(jobs), total=len(jobs), desc=label, unit="episode")
    clean = 0
    for index, row in bar:
        append_line(configs[index].folder / ROWS, asdict(row))
        done[index][row.seed] = row
        clean += row.clean
        bar.set_postfix_str(f"{clean} clean", refresh=False)
    reports = []
    for config, rows in zip(configs, done, strict=True):
        reports.append(ArmReport(config.arm, [rows[seed] for seed in config.seeds]))
    return reports


def _start(config: ScoreConfig) -> dict[int, EpisodeRow]:
    """Write the arm's settings and return the episodes it has already."""
    from uniforce_vtla.evaluation.arms import read_rows

    rows = config.folder / ROWS
    acts = what_acts(config)
    source = provenance()
    commits = [source["commit"]]
    if not config.resume:
        rows.unlink(missing_ok=True)
    if rows.exists():
        before = _settings(config.folder)
        if before.get("acts") != acts:
            where = f"episodes in {config.folder}"
            came = "of another one, or of an older version"
            do = "resume=false drops them; out=… or arm=… keeps them."
            raise ContractError(expected(where, "of this policy and calibration", came, do))
        commits = before.get("commits", [])
        if source["commit"] not in commits:
            logger.warning("%s: episodes of other code are kept; resume=false drops them", rows)
            commits = [*commits, source["commit"]]
    settings = asdict(config) | {"acts": acts, "commits": commits, "provenance": source}
    write_json(config.folder / SETTINGS, settings)
    return read_rows(rows)


def what_acts(config: ScoreConfig) -> dict[str, Any]:
    """Return version, level, policies and calibrations that an episode depends on.

    The words in its folder's name say the rest.
    """
    from lerobot_env_uniforce_wiping import LEVELS, level_hash

    return {
        "version": provenance()["version"],
        "level": level_hash(LEVELS[config.level]),
        "policies": list(map(content_of, config.policies)),
        "first_turn": config.first_seed % len(config.policies),
        "calibrations": {f: content_of(folder) for f, folder in config.rig.calibrations.items()},
    }


def content_of(policy: str) -> str:
    """Return the hash of a checkpoint's or calibration's loaded files; of a script its name."""
    folder = checkpoint_of(policy)
    return loaded_hash(folder, CheckpointError) if folder.is_dir() else policy


def write_report(config: ScoreConfig) -> list[ArmReport]:
    """Write ``wiping.json`` and ``wiping.png`` over all arms in ``config.out`` at its level.

    Of each arm the scenes count that it was asked for last: other ones in its folder may be
    development scenes. For every two arms: the exact McNemar test of clean success on the seeds
    they share.
    """
    from lerobot_env_uniforce_wiping import LEVELS, level_hash
    from uniforce_vtla.evaluation.arms import ArmReport, paired_clean, read_rows
    from uniforce_vtla.evaluation.pictures import draw_arms
    from uniforce_vtla.evaluation.statistics import mcnemar

    out = Path(config.out)
    reports = []
    arms = {}
    for file in sorted(out.glob(f"*/{ROWS}")):
        settings = _settings(file.parent)
        rows = read_rows(file)
        asked = range(settings["first_seed"], settings["first_seed"] + settings["rollouts"])
        found = [rows[seed] for seed in asked if seed in rows]
        if found and settings["level"] == config.level:
            report = ArmReport(settings["arm"], found)
            reports.append(report)
            arms[report.arm] = report.as_dict() | {
                "policies": settings.get("acts", {}).get("policies", []),
                "commits": settings.get("commits", []),
                "gripper": settings.get("gripper", "servo"),
            }
    tests = []
    for first, second in itertools.combinations(reports, 2):
        one, two = paired_clean(first.clean_by_seed, second.clean_by_seed)
        if one:
            pair = {"arms": [first.arm, second.arm], "n": len(one)}
            tests.append(pair | asdict(mcnemar(one, two)))
    content = {
        "level": config.level,
        "level_hash": level_hash(LEVELS[config.level]),
        "arms": arms,
        "tests": tests,
    }
    write_json(out / "wiping.json", content | provenance())
    draw_arms(reports, out / "wiping.png", title=f"wiping, level {config.level}, simulated")
    return reports


@command(ScoreConfig)
def main(config: ScoreConfig) -> None:
    from uniforce_vtla.evaluation.arms import table

    logging.basicConfig(level=logging.WARNING)
    start = time.perf_counter()
    score(config)
    print(table(write_report(config)))
    duration_s = time.perf_counter() - start
    print(f"scenes: {config.rollouts}, in {duration_s:.0f} s; columns: docs/definitions.md")
    print(f"films and episodes: {config.folder}; all that was scored: {config.out}/wiping.png")
