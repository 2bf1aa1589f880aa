"""Score a policy in the wiping scene: paired seeds, exclusive outcomes, events, intervals, a picture."""

from __future__ import annotations

import itertools
import json
import logging
import re
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lerobot_env_uniforce_wiping import LEVELS, level_hash
from lerobot_policy_pi05_uniforce.controller import stored_config
from uniforce_cli.boundary import command
from uniforce_cli.score_config import SCRIPTS, ScoreConfig, mounted_sensors
from uniforce_cli.score_worker import Job, score_job, video_path
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.arms import (
    ArmReport,
    EpisodeRow,
    read_rows,
    summarise,
    table,
    write_row,
)
from uniforce_vtla.evaluation.comparison import paired_clean
from uniforce_vtla.evaluation.pictures import draw_arms
from uniforce_vtla.evaluation.statistics import mcnemar
from uniforce_vtla.results_file import provenance, write_json

ROWS = "episodes.jsonl"


def score(config: ScoreConfig) -> ArmReport:
    """Score ``config.rollouts`` seeds; finished episodes survive a kill and are not repeated."""
    for policy in {*config.policies} - {"shipped", *SCRIPTS}:
        stored_config(Path(policy))  # refuses a damaged one before processes start
    return score_arms([config], config.workers)[0]


def score_arms(configs: Sequence[ScoreConfig], workers: int) -> list[ArmReport]:
    """Score several arms in turns, seed by seed, so that a killed run has paired seeds of all of them.

    Each episode is forced to disk when it ends; the next call goes on with what is missing.
    """
    done = [_start(config) for config in configs]
    jobs = _missing(configs, done)
    label = configs[0].arm if len(configs) == 1 else f"{len(configs)} arms"
    for index, row in tqdm(_episodes(jobs, workers), total=len(jobs), desc=label, unit="episode"):
        write_row(_folder(configs[index]) / ROWS, row)
        done[index][row.seed] = row
    return [
        summarise(config.arm, [rows[seed] for seed in _seeds(config)])
        for config, rows in zip(configs, done, strict=True)
    ]


def _start(config: ScoreConfig) -> dict[int, EpisodeRow]:
    """Write the arm's settings and return the episodes it has already."""
    folder = _folder(config)
    write_json(folder / "config.json", asdict(config) | {"provenance": provenance()})
    if not config.resume:
        (folder / ROWS).unlink(missing_ok=True)
    return read_rows(folder / ROWS)


def _seeds(config: ScoreConfig) -> range:
    return range(config.first_seed, config.first_seed + config.rollouts)


def _to_film(config: ScoreConfig) -> set[int]:
    """Return the seeds asked for by number whose video isn't there."""
    strangers = sorted(set(config.film) - set(_seeds(config)))
    if strangers:
        seeds = _seeds(config)
        do = "Film what is scored: set first_seed and rollouts."
        raise ContractError(expected("film", f"seeds {seeds[0]}…{seeds[-1]}", strangers, do))
    return {seed for seed in config.film if not video_path(_folder(config), seed).exists()}


def _missing(configs: Sequence[ScoreConfig], done: Sequence[dict[int, EpisodeRow]]) -> list[Job]:
    """Return what is left to do, all arms' first seeds first."""
    to_film = [_to_film(config) for config in configs]
    jobs = [
        (seed, index)
        for index, (config, rows) in enumerate(zip(configs, done, strict=True))
        for seed in _seeds(config)
        if seed not in rows or seed in to_film[index]
    ]
    return [Job(index, configs[index], _folder(configs[index]), seed) for seed, index in sorted(jobs)]


def _episodes(jobs: list[Job], workers: int) -> Iterable[tuple[int, EpisodeRow]]:
    workers = max(1, min(workers, len(jobs)))
    if workers == 1:
        yield from map(score_job, jobs)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        pending = [pool.submit(score_job, job) for job in jobs]
        try:
            for finished in as_completed(pending):
                yield finished.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _rig(config: ScoreConfig) -> str:
    return "+".join(mounted_sensors(config.left_sensor, config.right_sensor).values())


def _folder(config: ScoreConfig) -> Path:
    swap = f"_{config.swap.replace(':', '-')}" if config.swap else ""
    arm = re.sub(r"\W+", "-", config.arm.replace("+", "")).strip("-")
    control = f"_{config.control}" if config.control else ""
    return Path(config.out) / f"{arm}_{_rig(config)}_{config.level}{swap}{control}"


def scored_arms(out: Path, level: str) -> list[ArmReport]:
    """Return every arm scored so far into ``out`` at ``level``, in the order of their folders."""
    reports = []
    for file in sorted(out.glob("*/config.json")):
        settings = json.loads(file.read_text())
        rows = read_rows(file.parent / ROWS)
        if settings["level"] == level and rows:
            reports.append(summarise(settings["arm"], [rows[seed] for seed in sorted(rows)]))
    return reports


def paired_tests(reports: Sequence[ArmReport]) -> list[dict[str, Any]]:
    """Return the exact McNemar test of clean success for every two arms, on the seeds they share."""
    tests = []
    for first, second in itertools.combinations(reports, 2):
        one, two = paired_clean(first, second)
        if one:
            tests.append({"arms": [first.arm, second.arm], "n": len(one), **asdict(mcnemar(one, two))})
    return tests


def write_report(config: ScoreConfig) -> list[ArmReport]:
    """Write ``wiping.json`` and ``wiping.png`` over all arms scored into ``config.out``; return them."""
    out = Path(config.out)
    reports = scored_arms(out, config.level)
    arms = {report.arm: report.as_dict() for report in reports}
    content = {"level": config.level, "level_hash": level_hash(LEVELS[config.level]), "arms": arms}
    write_json(out / "wiping.json", content | {"tests": paired_tests(reports)} | provenance())
    draw_arms(reports, out / "wiping.png", title=f"wiping, level {config.level}, simulated")
    return reports


@command(ScoreConfig)
def main(config: ScoreConfig) -> int:
    """Entry of ``uniforce score``."""
    logging.basicConfig(level=logging.WARNING)
    start = time.perf_counter()
    score(config)
    print(table(write_report(config)))
    print(f"{config.rollouts} rollouts in {time.perf_counter() - start:.0f} s; results in {config.out}")
    return 0
