"""Score a policy in the wiping scene: paired seeds, exclusive outcomes, events, intervals, a picture."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

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


def write_report(config: ScoreConfig, reports: list[ArmReport]) -> dict[str, Any]:
    """Write ``wiping.json`` and ``wiping.png`` for the arms scored; return what was written."""
    from uniforce_vtla.evaluation.pictures import draw_arms

    out = Path(config.out)
    content = {"level": config.level, "arms": {r.arm: r.as_dict() for r in reports}, **provenance()}
    write_json(out / "wiping.json", content)
    draw_arms(reports, out / "wiping.png", title=f"wiping, level {config.level}, simulated")
    return content


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-score``."""
    logging.basicConfig(level=logging.WARNING)
    config = parse(ScoreConfig, argv)
    start = time.perf_counter()
    try:
        report = score(config)
    except UniForceError as error:
        print(f"score: {error}")
        return 2
    write_report(config, [report])
    print(table([report]))
    print(f"{config.rollouts} rollouts in {time.perf_counter() - start:.0f} s; results in {config.out}")
    return 0
