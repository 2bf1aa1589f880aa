"""Score a policy in the wiping scene: paired seeds, exclusive outcomes, events, intervals, a picture."""

from __future__ import annotations

import itertools
import json
import logging
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.commands.score_config import ScoreConfig, mounted_sensors
from uniforce_vtla.commands.score_worker import score_seeds
from uniforce_vtla.errors import UniForceError
from uniforce_vtla.evaluation.arms import (
    ArmReport,
    EpisodeRow,
    read_rows,
    summarise,
    table,
    write_row,
)
from uniforce_vtla.evaluation.pictures import draw_arms
from uniforce_vtla.evaluation.statistics import mcnemar
from uniforce_vtla.results_file import provenance, write_json


def score(config: ScoreConfig) -> ArmReport:
    """Score ``config.rollouts`` seeds; finished episodes survive a kill and are not repeated."""
    out = Path(config.out) / _folder(config)
    write_json(out / "config.json", asdict(config) | {"provenance": provenance()})
    rows_file = out / "episodes.jsonl"
    if not config.resume:
        rows_file.unlink(missing_ok=True)
    done = read_rows(rows_file)
    seeds = range(config.first_seed, config.first_seed + config.rollouts)
    todo = [seed for seed in seeds if seed not in done]
    for row in tqdm(_episodes(config, out, todo), total=len(todo), desc=f"{config.arm} on {_rig(config)}"):
        write_row(rows_file, row)
        done[row.seed] = row
    return summarise(config.arm, [done[seed] for seed in seeds])


def _episodes(config: ScoreConfig, out: Path, seeds: list[int]) -> Iterable[EpisodeRow]:
    workers = max(1, min(config.workers, len(seeds)))
    if workers == 1:
        yield from score_seeds(config, out, seeds)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_score_one, [(config, out, seed) for seed in seeds])


def _score_one(job: tuple[ScoreConfig, Path, int]) -> EpisodeRow:
    config, out, seed = job
    return next(iter(score_seeds(config, out, [seed])))


def _rig(config: ScoreConfig) -> str:
    return "+".join(mounted_sensors(config.left_sensor, config.right_sensor).values())


def _folder(config: ScoreConfig) -> str:
    swap = f"_{config.swap.replace(':', '-')}" if config.swap else ""
    return f"{config.arm.replace('+', '')}_{_rig(config)}_{config.level}{swap}"


def scored_arms(out: Path, level: str) -> list[ArmReport]:
    """Return every arm scored so far into ``out`` at ``level``, in the order of their folders."""
    reports = []
    for file in sorted(out.glob("*/config.json")):
        settings = json.loads(file.read_text())
        rows = read_rows(file.parent / "episodes.jsonl")
        if settings["level"] == level and rows:
            reports.append(summarise(settings["arm"], [rows[seed] for seed in sorted(rows)]))
    return reports


def paired_tests(reports: Sequence[ArmReport]) -> list[dict[str, Any]]:
    """Return the exact McNemar test of clean success for every two arms, on the seeds they share."""
    tests = []
    for first, second in itertools.combinations(reports, 2):
        one, two = ({row.seed: row.clean for row in report.rows} for report in (first, second))
        seeds = sorted(one.keys() & two.keys())
        if seeds:
            test = mcnemar([one[s] for s in seeds], [two[s] for s in seeds])
            tests.append({"arms": [first.arm, second.arm], "n": len(seeds), **asdict(test)})
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


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-score``."""
    logging.basicConfig(level=logging.WARNING)
    config = parse(ScoreConfig, argv)
    start = time.perf_counter()
    try:
        score(config)
    except UniForceError as error:
        print(f"score: {error}")
        return 2
    print(table(write_report(config)))
    print(f"{config.rollouts} rollouts in {time.perf_counter() - start:.0f} s; results in {config.out}")
    return 0
