"""A monitor of a sensor's health: fit a kind's range of latents; say which faults it notices."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from joblib import Parallel, delayed
from scipy.stats import mannwhitneyu
from tqdm import tqdm

from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.readings import encode_now
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_cli.boundary import Level, command, worker_process
from uniforce_vtla.errors import SensorError
from uniforce_vtla.options import Count, Names, OutFile, OutFolder, Text, Workers, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.latent_range import HealthMonitor, LatentRange
from uniforce_vtla.tokenizer.weights import SIZES
from uniforce_vtla.tokenizer.worn_heads import WornSequences, draw_worn

EVERY = 2  # steps between two looks, as tiny takes them
LOOKS = 8  # that make half a second
# of the largest distance seen in clean wipes: in free air, and while something is held (at 1.1
# four of 25 + 25 demos, which wear these sensors on the other finger, went over it by 2 %)
FREE_MARGIN = 1.1
RUN_MARGIN = 1.25
# development scenes, and units that no benchmark wears
LIMITS = [(39_700 + n, 20 + n) for n in range(16)]
CLEAN = [(39_720 + n, 40 + n) for n in range(40)]
FAULTY = [(39_780 + n, 100 + n) for n in range(4)]

Size = Annotated[str, Names(SIZES)]


@dataclass
class MonitorCommand:
    """Fit the ranges of kinds (part=fit), or watch wipes with every fault (part=faults).

    Example: python -m benchmarks.stress.monitor out=outputs/monitor.json
    """

    part: Literal["fit", "faults"] = "faults"
    kinds: Text = "tactip"  # comma between them
    level: Level = "touch"
    size: Size = "small"  # tokenizer
    # part=fit: where the ranges go; to ship them uniforce_vtla/tokenizer/assets/small
    folder: OutFolder = "outputs/latent_ranges"
    clean: Count = 40  # at most; wipes without a fault
    faulty: Count = 2  # wipes per operator and dose, at most four
    workers: Workers = 2
    out: OutFile = "outputs/monitor.json"


@dataclass(frozen=True)
class Watched:
    """One wipe: how far its latents were from healthy ones, in units of the range's limits."""

    free: float  # at the start, in free air
    run: float  # the largest over half a second
    alarm_s: float  # of the first alarm; inf: none
    seconds: float  # of the whole wipe
    refused: bool  # a frame wasn't encoded at all: the robot stops there without a monitor

    @property
    def score(self) -> float:
        """The larger of both; an alarm above 1."""
        return max(self.free, self.run)


def watch(level: str, sensor: str, seed: int, usual: LatentRange, size: str) -> Watched:
    """Let the expert wipe by the true wrench with ``sensor`` right; stop at a refused frame."""
    worker_process()
    tokenizer = Tokenizer.from_pretrained(size)
    env = WipeEnv(level, right_sensor=sensor, drawn=("right",))
    distances = []
    refused = False
    step = 0
    try:
        for step, _ in enumerate(walk(env, WipeExpert(), seed)):
            if step % EVERY == 0:
                latents = encode_now(env, "right", tokenizer).as_subclass(torch.Tensor)
                distances.append(float(usual.distance(latents)))
    except SensorError:
        refused = True
    return watched(np.array(distances), usual, step / env.metadata["render_fps"], refused)


def watched(distances: np.ndarray, usual: LatentRange, seconds: float, refused: bool) -> Watched:
    """Return what a monitor makes of the looks' (n,) distances."""
    if len(distances) < LOOKS:
        return Watched(0.0, 0.0, seconds if refused else np.inf, seconds, refused)
    monitor = HealthMonitor(usual, "right", LOOKS)
    ratios = np.array([monitor.judge(float(distance)) for distance in distances])  # (n, 2)
    alarms = np.flatnonzero((ratios > 1).any(axis=1))
    alarm_s = np.inf
    if len(alarms):
        alarm_s = float((alarms[0] + 1) * seconds / len(distances))
    free, run = ratios.max(axis=0).tolist()
    return Watched(free, run, alarm_s, seconds, refused)


def _watch_all(
    config: MonitorCommand, rows: Iterable[tuple[str, int]], usual: LatentRange, desc: str
) -> list[Watched]:
    jobs = []
    for sensor, seed in rows:
        jobs.append(delayed(watch)(config.level, sensor, seed, usual, config.size))
    found = Parallel(config.workers, return_as="generator")(jobs)
    return list(tqdm(found, total=len(jobs), desc=desc, disable=None))


def fit(config: MonitorCommand, kind: str) -> Path:
    """Fit a kind's range to drawn contacts of many units; set its limits by clean wipes; store."""
    tokenizer = Tokenizer.from_pretrained(config.size)
    latents, _ = draw_worn(WornSequences(), kind, tokenizer)
    usual = LatentRange.fit(latents.flatten(0, 1), kind, tokenizer.hash)
    usual.free_limit = usual.run_limit = 1.0
    rows = [(f"{kind}:{unit}", seed) for seed, unit in LIMITS]
    seen = _watch_all(config, rows, usual, f"clean wipes, {kind}")
    usual.free_limit = round(FREE_MARGIN * max(of_all(seen, "free")), 3)
    usual.run_limit = round(RUN_MARGIN * max(of_all(seen, "run")), 3)
    return usual.save(Path(config.folder) / f"latent_range_{kind}")


def faults(config: MonitorCommand, kind: str) -> dict[str, Any]:
    """Return what the shipped range of a kind notices, operator by operator and dose by dose."""
    usual = LatentRange.from_pretrained(kind, config.size)
    clean_rows = [(f"{kind}:{unit}", seed) for seed, unit in CLEAN[: config.clean]]
    clean = _watch_all(config, clean_rows, usual, f"clean, {kind}")
    hours = sum(of_all(clean, "seconds")) / 3600
    operators = {}
    for name, operator in OPERATORS.items():
        cells = []
        for dose in operator.doses:
            rows = []
            for seed, unit in FAULTY[: config.faulty]:
                words = worn_with(operator, f"{kind}:{unit}", dose)
                if words:
                    rows.append((words, seed))
            if rows:
                seen = _watch_all(config, rows, usual, f"{name} {dose:g}, {kind}")
                cells.append({"dose": dose, **summary(seen, clean)})
        if cells:
            operators[name] = {"unit": operator.unit, "cells": cells}
    return {
        "free_limit": usual.free_limit,
        "run_limit": usual.run_limit,
        "clean": {
            "wipes": len(clean),
            "hours": round(hours, 3),
            "false_alarms": sum(one.score > 1 for one in clean),
        },
        "largest_clean": {
            "free": max(of_all(clean, "free")),
            "run": max(of_all(clean, "run")),
        },
        "operators": operators,
    }


def of_all(wipes: list[Watched], name: str) -> list[Any]:
    """Return one thing of all wipes."""
    return list(map(attrgetter(name), wipes))


def summary(seen: list[Watched], clean: list[Watched]) -> dict[str, Any]:
    """Return how one dose is noticed: share of wipes, median time, AUROC against clean wipes."""
    refused = of_all(seen, "refused")
    scores = np.where(refused, np.inf, of_all(seen, "score"))
    usual = of_all(clean, "score")
    auroc = mannwhitneyu(scores, usual).statistic / (len(scores) * len(usual))
    noticed = scores > 1
    after_s = None
    if noticed.any():
        alarms_s = np.minimum(of_all(seen, "alarm_s"), of_all(seen, "seconds"))
        after_s = round(float(np.median(alarms_s[noticed])), 2)
    return {
        "n": len(seen),
        "noticed": int(noticed.sum()),
        "refused": sum(refused),
        "auroc": round(float(auroc), 3),
        "after_s": after_s,
        "free": round(float(np.mean(of_all(seen, "free"))), 2),
        "run": round(float(np.mean(of_all(seen, "run"))), 2),
    }


@command(MonitorCommand)
def main(config: MonitorCommand) -> None:
    torch.set_num_threads(1)
    kinds = split(config.kinds)
    if config.part == "fit":
        for kind in kinds:
            print(f"written to {fit(config, kind)}")
        return
    found = {kind: faults(config, kind) for kind in kinds}
    for kind, rows in found.items():
        print(f"{kind}: {rows['clean']}")
        for name, row in rows["operators"].items():
            said = ""
            for cell in row["cells"]:
                said += f"  {cell['dose']:g}: {cell['noticed']}/{cell['n']}"
            print(f"  {name:20} [{row['unit']}] noticed{said}")
    content = {"level": config.level, "size": config.size, "kinds": found}
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
