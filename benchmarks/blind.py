"""Does the scene need touch? Expert and blind scripts on the same seeds, set points swept."""

import itertools
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.blind_styles import STYLES, MeasuredRelative
from lerobot_env_uniforce_wiping.blind import BlindScript, BlindSettings
from lerobot_env_uniforce_wiping.env import WipeEnv
from lerobot_env_uniforce_wiping.episodes import Script, run_script
from lerobot_env_uniforce_wiping.expert import WipeExpert
from lerobot_env_uniforce_wiping.levels import get_level, level_hash
from uniforce_cli.boundary import Level, command
from uniforce_vtla.evaluation.episode import EpisodeResult, ScoreLimits
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.options import Count, Names, Newtons, OutFile, Seed, Workers
from uniforce_vtla.results_file import provenance, write_json

EXPERTS = ("both", "left", "right", "none")


Experts = Annotated[list[str], Names(EXPERTS)]


@dataclass
class BlindConfig:
    """Roll out the expert and the blind scripts; write blind_scripts.json.

    Example: python -m benchmarks.blind level=paper episodes=100 workers=2
    """

    level: Level = "paper"  # name of a locked level
    episodes: Count = 100  # seeds 0 … n − 1, the same for every script
    first_seed: Seed = 0  # where the seeds start
    press_N: Newtons = field(default_factory=lambda: [4.0, 5.0, 6.0, 7.0])  # blind press set points
    grip_open_N: Newtons = field(default_factory=lambda: [11.0, 13.0])  # a nominal width: pads yield, so more
    grip_relative_N: Newtons = field(default_factory=lambda: [6.5, 7.5])  # inside the measured width
    experts: Experts = field(default_factory=lambda: list(EXPERTS))  # which fingers the expert reads
    workers: Workers = 2  # processes
    out: OutFile = "outputs/blind/blind_scripts.json"  # the result file


@dataclass(frozen=True)
class Job:
    """One episode of one script; ``press_N`` is 0 for the expert, ``style`` then names its fingers."""

    kind: str  # "expert" or "blind"
    style: str
    press_N: float
    grip_N: float
    level: str
    seed: int

    @property
    def name(self) -> str:
        """What the result file calls the script."""
        if self.kind == "expert":
            return f"expert_{self.style}"
        return f"{self.style}_press{self.press_N:g}_grip{self.grip_N:g}"


def make_script(job: Job) -> Script:
    """Build the controller a job asks for."""
    if job.kind == "expert":
        return WipeExpert(job.style)  # type: ignore[arg-type]
    return BlindScript(BlindSettings(job.press_N, job.grip_N), STYLES[job.style])


def run_job(job: Job) -> tuple[Job, EpisodeResult]:
    """Run one episode; called in a worker process."""
    return job, run_script(WipeEnv(level=job.level), make_script(job), job.seed)


def all_jobs(config: BlindConfig) -> list[Job]:
    """Return every script × seed."""
    scripts = [("expert", fingers, 0.0, 0.0) for fingers in config.experts]
    for style, regulator in STYLES.items():
        grips_N = config.grip_relative_N if regulator is MeasuredRelative else config.grip_open_N
        scripts += [("blind", style, p, g) for p, g in itertools.product(config.press_N, grips_N)]
    seeds = range(config.first_seed, config.first_seed + config.episodes)
    return [Job(*script, level=config.level, seed=seed) for script in scripts for seed in seeds]


def summarise(results: Sequence[EpisodeResult]) -> dict[str, Any]:
    """Count one script's outcomes, events and the reasons behind them."""
    n = len(results)
    clean = sum(r.clean for r in results)
    unexplained = [r for r in results if not r.success and not r.slippage and not r.excess_force]
    return {
        "n": n,
        "clean": clean,
        "clean_wilson95": [wilson(clean, n).low, wilson(clean, n).high],
        "outcomes": dict(Counter(r.outcome for r in results)),
        "slippage": sum(r.slippage for r in results),
        "excess_force": sum(r.excess_force for r in results),
        "reasons": dict(Counter(reason for r in results for reason in r.reasons)),
        "failures_without_event": dict(Counter(reason for r in unexplained for reason in r.reasons)),
        "press_mean_N": sum(r.metrics["press_mean_N"] for r in results) / n,
        "grip_mean_N": sum(r.metrics["grip_mean_N"] for r in results) / n,
        "duration_mean_s": sum(r.metrics["duration_s"] for r in results) / n,
    }


def run_all(config: BlindConfig) -> dict[str, dict[str, Any]]:
    """Return script name → summary."""
    jobs = all_jobs(config)
    episodes = Parallel(config.workers, return_as="generator")(delayed(run_job)(job) for job in jobs)
    done = list(tqdm(episodes, total=len(jobs), desc="episodes"))
    names = dict.fromkeys(job.name for job, _ in done)
    return {name: summarise([r for job, r in done if job.name == name]) for name in names}


@command(BlindConfig)
def main(config: BlindConfig) -> None:
    """Entry of ``python -m benchmarks.blind``: run the sweep, print a table, write the result file."""
    scripts = run_all(config)
    blind = {name: s for name, s in scripts.items() if not name.startswith("expert_")}
    best = max(blind, key=lambda name: blind[name]["clean"], default=None)
    content = {
        "level": config.level,
        "level_hash": level_hash(get_level(config.level)),
        "seeds": [config.first_seed, config.first_seed + config.episodes - 1],
        "limits": asdict(ScoreLimits()),
        "best_blind": best,
        "scripts": scripts,
    }
    path = write_json(Path(config.out), content | provenance())
    for name, s in scripts.items():
        print(f"{name:42s} clean {s['clean']:3d}/{s['n']}  {s['outcomes']}  {s['reasons']}")
    print(f"best blind: {best or 'none asked for'}; written to {path}")


if __name__ == "__main__":
    sys.exit(main())
