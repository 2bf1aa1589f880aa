"""Score a policy in the wiping scene: paired seeds, exclusive outcomes, events, intervals, a picture."""

from __future__ import annotations

import itertools
import json
import logging
import re
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from uniforce_cli.boundary import Level, Sensor, command
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import (
    Count,
    CountOrZero,
    FolderPath,
    OutFolder,
    Pattern,
    Policies,
    Seed,
    Seeds,
    Slots,
    Workers,
    split,
)
from uniforce_vtla.results_file import provenance, write_json

if TYPE_CHECKING:
    from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow

SCRIPTS = ("expert", "blind")  # the scene's own: one regulates by both pads' true wrench, one uses no touch
ROWS = "episodes.jsonl"
ArmName = Annotated[str, Pattern("a name", r"[^/\\]{1,100}", "V+T")]


@dataclass(frozen=True)
class Rig:
    """A scene's level and what the fingers wear there; "" is the usual sensor, no swap and no calibration."""

    level: str
    left_sensor: str = ""
    right_sensor: str = ""
    swap: str = ""
    left_calibration: str = ""
    right_calibration: str = ""

    @property
    def mounted(self) -> dict[Finger, str]:
        """Finger → sensor of the scene; the usual rig where none is named."""
        return {"left": self.left_sensor or "gelsight", "right": self.right_sensor or "tactip"}

    @property
    def calibrations(self) -> dict[Finger, str]:
        """Finger → folder of the calibration it wears."""
        worn: dict[Finger, str] = {"left": self.left_calibration, "right": self.right_calibration}
        return {finger: folder for finger, folder in worn.items() if folder}


@dataclass
class ScoreConfig:
    """Roll a checkpoint out and score it from simulator truth.

    Example: uniforce score policy=outputs/train/checkpoints/last/pretrained_model swap=touch0:left
    """

    policy: Policies = "shipped"  # checkpoint folders (several, e.g. training seeds, take turns scene by scene)
    arm: ArmName = ""  # name of this arm in the table; "" = V+T, or the script's own
    level: Level = "paper"  # the shipped policy learnt at paper
    left_sensor: Sensor = ""  # "" = gelsight, and it must be what the policy knows
    right_sensor: Sensor = ""  # likewise; "" = tactip. Naming a sensor allows it to differ from training
    left_calibration: FolderPath = ""  # of `uniforce calibrate`: what the left finger's sensor wears
    right_calibration: FolderPath = ""  # likewise
    swap: Slots = ""  # e.g. touch0:left — which finger fills which slot
    control: Literal["", "masked", "shuffled"] = ""  # touch taken away | another scene's touch of the same phase
    rollouts: Count = 20  # 20 for parity with the paper, ≥ 200 for claims
    first_seed: Seed = 10_000  # demos are recorded from seed 0 on: scored scenes are never trained on
    workers: Workers = 2  # processes, one torch thread each
    videos: CountOrZero = 1  # episodes filmed, the first ones
    film: Seeds = field(default_factory=list)  # seeds filmed besides; rolled out again where scored unfilmed
    resume: bool = True  # keep episodes already scored in `out`
    out: OutFolder = "outputs/score"  # rows, table, picture and videos go here

    def __post_init__(self) -> None:
        """Name the arm."""
        self.arm = self.arm or (self.policy if self.policy in SCRIPTS else "V+T")

    @property
    def policies(self) -> list[str]:
        """Policies that take turns."""
        return split(self.policy) or [self.policy]

    def policy_of(self, seed: int) -> str:
        """Return which policy acts in the scene of that seed."""
        from uniforce_vtla.evaluation.arms import whose_turn

        return whose_turn(seed - self.first_seed, self.policies)

    @property
    def seeds(self) -> range:
        """Scenes that are scored."""
        return range(self.first_seed, self.first_seed + self.rollouts)

    @property
    def rig(self) -> Rig:
        """The scene's level and what the fingers wear."""
        return Rig(**{field.name: getattr(self, field.name) for field in fields(Rig)})

    @property
    def folder(self) -> Path:
        """Where this arm's rows, sheets and videos go."""
        swap = f"_{self.swap.replace(':', '-')}" if self.swap else ""
        swap += "".join(f"_{finger}-calibrated" for finger in self.rig.calibrations)
        arm = re.sub(r"\W+", "-", self.arm.replace("+", "")).strip("-")
        control = f"_{self.control}" if self.control else ""
        return Path(self.out) / f"{arm}_{'+'.join(self.rig.mounted.values())}_{self.level}{swap}{control}"

    def video(self, seed: int) -> Path:
        """Return where an episode's video lies, once it is filmed."""
        return self.folder / f"seed_{seed}.mp4"


def score(config: ScoreConfig) -> ArmReport:
    """Score ``config.rollouts`` seeds; finished episodes survive a kill and are not repeated."""
    check_policies(config)
    return score_arms([config], config.workers)[0]


def check_policies(config: ScoreConfig) -> None:
    """Refuse a damaged checkpoint and a slot it lacks, before processes start."""
    from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config

    for policy in {*config.policies} - {*SCRIPTS}:
        settings = stored_config(shipped_checkpoint() if policy == "shipped" else Path(policy))
        settings.swap = config.swap or settings.swap
        settings.finger_by_slot()


def check_film(film: Sequence[int], seeds: range) -> None:
    """Refuse to film what isn't scored."""
    if unscored := sorted(set(film) - set(seeds)):
        do = "Film what is scored: set first_seed and rollouts."
        raise ContractError(expected("film", f"seeds {seeds[0]}…{seeds[-1]}", unscored, do))


def score_arms(configs: Sequence[ScoreConfig], workers: int) -> list[ArmReport]:
    """Score several arms in turns, seed by seed, so that a killed run has paired seeds of all of them.

    Each episode is forced to disk when it ends; the next call goes on with what is missing. Rollouts run on joblib's
    active backend, its own processes unless ``joblib.parallel_config`` names another.
    """
    from joblib import Parallel, delayed
    from tqdm import tqdm

    from uniforce_cli.score_worker import Job, score_job
    from uniforce_vtla.evaluation.arms import ArmReport, write_row

    for config in configs:
        check_film(config.film, config.seeds)
    done = [_start(config) for config in configs]
    missing = [  # all arms' first seeds first
        (seed, index)
        for index, (config, rows) in enumerate(zip(configs, done, strict=True))
        for seed in config.seeds
        if seed not in rows or (seed in config.film and not config.video(seed).exists())
    ]
    jobs = [Job(index, configs[index], seed) for seed, index in sorted(missing)]
    label = configs[0].arm if len(configs) == 1 else f"{len(configs)} arms"
    pool = Parallel(max(1, min(workers, len(jobs))), return_as="generator_unordered", batch_size=1)
    episodes = pool(delayed(score_job)(job) for job in jobs)
    for index, row in tqdm(episodes, total=len(jobs), desc=label, unit="episode", disable=None):
        write_row(configs[index].folder / ROWS, row)
        done[index][row.seed] = row
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
        one, two = paired_clean(first, second)
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
