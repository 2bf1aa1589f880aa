"""Score a policy in the wiping scene: paired seeds, exclusive outcomes, events, intervals, a picture."""

from __future__ import annotations

import itertools
import json
import logging
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from uniforce_cli.boundary import command
from uniforce_cli.score_settings import SCRIPTS, ScoreConfig
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.results_file import append_line, provenance, write_json

if TYPE_CHECKING:
    from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow

ROWS = "episodes.jsonl"


def score(config: ScoreConfig) -> ArmReport:
    """Score ``config.rollouts`` seeds; finished episodes survive a kill and are not repeated."""
    check_policies(config)
    return score_arms([config], config.workers)[0]


def check_policies(config: ScoreConfig) -> None:
    """Refuse an unknown sensor or fault, a damaged checkpoint and a slot it lacks, before processes start."""
    _ = config.rig.kinds
    from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config

    for policy in {*config.policies} - {*SCRIPTS}:
        settings = stored_config(shipped_checkpoint() if policy == "shipped" else Path(policy))
        settings.swap = config.swap or settings.swap
        settings.finger_by_slot()


def score_arms(configs: Sequence[ScoreConfig], workers: int) -> list[ArmReport]:
    """Score several arms in turns, seed by seed, so that a killed run has paired seeds of all of them.

    Each episode is forced to disk when it ends; the next call goes on with what is missing. Rollouts run on joblib's
    active backend, its own processes unless ``joblib.parallel_config`` names another.
    """
    from joblib import Parallel, delayed
    from tqdm import tqdm

    from uniforce_cli.score_worker import score_job
    from uniforce_vtla.evaluation.arms import ArmReport

    for config in configs:
        if unscored := sorted(set(config.film) - set(config.seeds)):
            wanted, do = (
                f"seeds {config.seeds[0]}…{config.seeds[-1]}",
                "Film what is scored: set first_seed and rollouts.",
            )
            raise ContractError(expected("film", wanted, unscored, do))
    done = [_start(config) for config in configs]
    missing = [  # all arms' first seeds first
        (seed, index)
        for index, (config, rows) in enumerate(zip(configs, done, strict=True))
        for seed in config.seeds
        if seed not in rows or (seed in config.film and not config.video(seed).exists())
    ]
    jobs = [delayed(score_job)(index, configs[index], seed) for seed, index in sorted(missing)]
    label = configs[0].arm if len(configs) == 1 else f"{len(configs)} arms"
    pool = Parallel(max(1, min(workers, len(jobs))), return_as="generator_unordered", batch_size=1)
    bar, clean = tqdm(pool(jobs), total=len(jobs), desc=label, unit="episode"), 0
    for index, row in bar:
        append_line(configs[index].folder / ROWS, asdict(row))
        done[index][row.seed] = row
        clean += row.clean
        bar.set_postfix_str(f"{clean} clean", refresh=False)
    return [ArmReport(c.arm, [rows[seed] for seed in c.seeds]) for c, rows in zip(configs, done, strict=True)]


def _start(config: ScoreConfig) -> dict[int, EpisodeRow]:
    """Write the arm's settings and return the episodes it has already."""
    from uniforce_vtla.evaluation.arms import read_rows

    write_json(config.folder / "config.json", asdict(config) | {"provenance": provenance()})
    if not config.resume:
        (config.folder / ROWS).unlink(missing_ok=True)
    return read_rows(config.folder / ROWS)


def write_report(config: ScoreConfig) -> list[ArmReport]:
    """Write ``wiping.json`` and ``wiping.png`` over all arms scored into ``config.out`` at its level; return them.

    For every two arms: the exact McNemar test of clean success on the seeds they share.
    """
    from lerobot_env_uniforce_wiping import LEVELS, level_hash
    from uniforce_vtla.evaluation.arms import ArmReport, read_rows
    from uniforce_vtla.evaluation.comparison import paired_clean
    from uniforce_vtla.evaluation.pictures import draw_arms
    from uniforce_vtla.evaluation.statistics import mcnemar

    out, reports, tests = Path(config.out), [], []
    for file in sorted(out.glob("*/config.json")):
        settings, rows = json.loads(file.read_text()), read_rows(file.parent / ROWS)
        if settings["level"] == config.level and rows:
            reports.append(ArmReport(settings["arm"], [rows[seed] for seed in sorted(rows)]))
    for first, second in itertools.combinations(reports, 2):
        one, two = paired_clean(first.clean_by_seed, second.clean_by_seed)
        if one:
            tests.append({"arms": [first.arm, second.arm], "n": len(one), **asdict(mcnemar(one, two))})
    content: dict[str, Any] = {"level": config.level, "level_hash": level_hash(LEVELS[config.level])}
    content |= {"arms": {report.arm: report.as_dict() for report in reports}, "tests": tests}
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
    print(f"{config.rollouts} rollouts in {time.perf_counter() - start:.0f} s; results in {config.out}")
