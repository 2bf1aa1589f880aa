"""Worth of more data: demonstrations against clean wipes, pretraining pairs against zero-shot force.

Both are development: wipes of ``development`` scenes, and the set ``fe_dev_v1`` of contacts by finite elements.
"""

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from tqdm import tqdm

from benchmarks.charts.front import Point, publish
from benchmarks.ledger import update
from benchmarks.pretraining_choices import (
    CHOICES,
    PretrainingChoicesCommand,
    frozen_facts,
    measure,
    pretrained,
)
from uniforce_cli.boundary import command, one_thread
from uniforce_cli.score import score_arms
from uniforce_cli.score_settings import ScoreConfig
from uniforce_datasets.view_plan import read_marker
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.options import Count, Numbers, OutFolder, Seed, View, Workers, split
from uniforce_vtla.results_file import write_json
from uniforce_vtla.tokenizer.pair_cache import rigs

# of pretraining_choices: how the shipped tokenizer's latents agree
SHIPPED_CHOICE = "latent's own unit"
SHIPPED_DEMOS = 50
RECIPE = (
    "policy=pi05_uniforce",
    "policy.size=tiny",
    "policy.device=cpu",
    "dataset.repo_id=local/view",
    "batch_size=32",
)


@dataclass
class DataChartCommand:
    """Train policies on fewer and more demonstrations of a view, or tokenizers on fewer and more pairs; chart both.

    What was trained before is taken from ``out``; run it again to go on. Half an hour of a core a policy, some
    5 to 15 minutes a tokenizer.

    Example: python -m benchmarks.charts.data view=outputs/view demos=10,25,50
    """

    part: Literal["demos", "pairs"] = "demos"
    view: View = ""  # demonstrations; parts of it take the same number of each of its sources
    demos: Numbers = "10,25,50"
    steps: Count = 6000  # of each policy
    rollouts: Count = 24  # scenes
    first_seed: Seed = 20_000  # development
    workers: Workers = 2  # that roll out
    units: Numbers = "64,128,256,512"  # per rig, for each of which a tokenizer is pretrained
    tokenizer_steps: Count = 1000
    # demos_10/, units_64/, chart_data.json and a picture per part
    out: OutFolder = "outputs/chart_data"


def chosen(episodes: Sequence[dict[str, Any]], count: int) -> list[int]:
    """Return the numbers of so many episodes, the first ones of each source in turns."""
    sources = list(dict.fromkeys(episode["source"] for episode in episodes))
    rank: dict[str, int] = dict.fromkeys(sources, 0)
    order = []
    for number, episode in enumerate(episodes):
        order.append((rank[episode["source"]], sources.index(episode["source"]), number))
        rank[episode["source"]] += 1
    return sorted(number for _, _, number in sorted(order)[:count])


def policy_of(config: DataChartCommand, episodes: list[int]) -> tuple[Path, float]:
    """Return a checkpoint trained on these episodes, trained now where it isn't yet, and the hours that took."""
    folder = Path(config.out) / f"demos_{len(episodes)}"
    checkpoint, took = folder / "checkpoints" / "last" / "pretrained_model", folder / "took.json"
    if not took.is_file():
        begun = time.monotonic()
        settings = [
            *RECIPE,
            f"dataset.root={config.view}",
            f"dataset.episodes={episodes}",
            f"steps={config.steps}",
        ]
        settings += [f"output_dir={folder}"]
        if checkpoint.is_dir():  # a killed run left it
            settings = ["resume=true", f"config_path={checkpoint / 'train_config.json'}"]
        subprocess.run([sys.executable, "-m", "uniforce_cli.main", "train", *settings], check=True)
        write_json(took, {"hours": (time.monotonic() - begun) / 3600})
    return checkpoint, json.loads(took.read_text())["hours"]


def demo_points(config: DataChartCommand) -> tuple[list[Point], dict[str, Any]]:
    """Return a point per number of demonstrations, over their minutes, and what else is worth keeping."""
    if not config.view:
        raise ContractError(
            expected("view", "a training view's folder", "none", "Make one with uniforce view.")
        )
    facts = read_marker(Path(config.view))
    parts = [chosen(facts["episodes"], int(count)) for count in split(config.demos)]
    minutes = [
        sum(facts["episodes"][k]["length"] for k in part) / facts["fps"] / 60 for part in parts
    ]
    trained = [policy_of(config, part) for part in tqdm(parts, desc="policies")]
    arms = [
        ScoreConfig(policy=str(checkpoint), arm=f"{len(part)} demos", rollouts=config.rollouts,
                    first_seed=config.first_seed, videos=0, out=config.out)
        for (checkpoint, _), part in zip(trained, parts, strict=True)
    ]  # fmt: skip
    points, kept = [], {}
    for report, part, cost, (_, hours) in zip(
        score_arms(arms, config.workers), parts, minutes, trained, strict=True
    ):
        clean = wilson(report.count("clean"), report.n)
        share, default = clean.k / clean.n, len(part) == SHIPPED_DEMOS
        points.append(Point(report.arm, cost, share, clean.low, clean.high, default))
        kept[report.arm] = report.as_dict() | {"hours_of_training": hours}
    return points, kept


def pair_points(config: DataChartCommand) -> tuple[list[Point], dict[str, Any]]:
    """Return a point per number of units, over the pairs that are drawn of them, and all that was measured."""
    one_thread()
    torch.set_num_threads(1)
    points, kept = [], {}
    for units in tqdm([int(count) for count in split(config.units)], desc="tokenizers"):
        work = Path(config.out) / f"units_{units}"
        run = PretrainingChoicesCommand(steps=config.tokenizer_steps, units=units, work=str(work))
        row = measure(run, pretrained(run, SHIPPED_CHOICE, seed=0), 0, [], frozen_facts(run))
        data = replace(CHOICES[SHIPPED_CHOICE][0], units=units)
        pairs = len(rigs(data)) * units * data.pairs_per_unit
        points.append(
            Point(f"{units} units", pairs, row["fz_r2"], row["fz_r2_worst"], row["fz_r2"])
        )
        kept[f"{units} units"] = row
    return points, kept


@command(DataChartCommand)
def main(config: DataChartCommand) -> None:
    """Entry of ``python -m benchmarks.charts.data``."""
    demos = config.part == "demos"
    points, kept = demo_points(config) if demos else pair_points(config)
    cost, score = (
        ("minutes of demonstrations", "clean, development scenes, 95 % interval")
        if demos
        else ("pairs drawn", "zero-shot Fz R² on fe_dev_v1, mean and worst transfer")
    )
    path = Path(config.out) / "chart_data.json"
    content = publish(
        points, path.with_name(f"chart_data_{config.part}.png"), "simulated", cost, score
    )
    print(f"* on the front; written to {update(path, config.part, content | {'rows': kept})}")


if __name__ == "__main__":
    sys.exit(main())
