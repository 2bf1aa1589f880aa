"""The whole line on a laptop: record, train, roll out with trained and swapped sensors, score, show."""

from __future__ import annotations

import logging
import os
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from uniforce_cli.boundary import command
from uniforce_cli.option_types import Level
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json

MARKER = "uniforce_demo.json"  # in a folder that the next demo may empty


@dataclass
class DemoConfig:
    """Run every stage once, small: no robot, no GPU, about ten minutes on two cores.

    Example: uniforce demo rollouts=4 out=outputs/demo
    """

    episodes: Count = 3  # demos recorded live; enough to see every stage, too few to learn from
    train_steps: Count = 20  # optimiser steps on those demos; shows that training runs, not what it can reach
    rollouts: Count = 4  # per arm, with the shipped policy; a smoke test, no claim
    level: Level = "paper"  # the level the shipped policy was trained at
    out: OutFolder = "outputs/demo"  # everything goes here; an earlier demo there is replaced


# arm → (left, right sensor, swap): the shipped policy learnt touch0 = right TacTip, never retrained
ARMS = {
    "V+T": ("gelsight", "tactip", ""),
    "V+G": ("gelsight", "tactip", "touch0:left"),
    "V+U": ("uskin", "tactip", "touch0:left"),
}


def say(step: str, text: str) -> None:
    """Print a headline of the demo."""
    print(f"\n[{step}] {text}", flush=True)


def run(config: DemoConfig) -> Path:
    """Run the demo; return the picture page's path."""
    from uniforce_cli.demo_page import draw_demo_page
    from uniforce_cli.lerobot_training import train
    from uniforce_cli.record import RecordConfig, record
    from uniforce_cli.score import ScoreConfig, score
    from uniforce_cli.view import ViewConfig, make_view
    from uniforce_vtla.evaluation.arms import table

    out = Path(config.out)
    _start_over(out)
    say("1/5", f"recording {config.episodes} demos with the scripted expert (GelSight left, TacTip right)")
    recording = RecordConfig(episodes=config.episodes, level=config.level, root=str(out / "demos"))
    record(recording)
    say("2/5", "training view: cameras resized once, touch encoded once by the frozen tokenizer")
    # few demos, and the nudged expert may have an event in each of them: all that wiped the board, as the policy learnt
    make_view(ViewConfig(roots=str(out / "demos"), out=str(out / "view"), keep_events=True))
    say("3/5", f"training a tiny policy for {config.train_steps} steps with LeRobot's own trainer")
    train(_train_arguments(config, out))
    say("4/5", "rolling out the shipped policy: trained sensor, then two swapped ones, nothing retrained")
    reports = []
    for arm, (left, right, swap) in ARMS.items():
        scoring = ScoreConfig(
            arm=arm, left_sensor=left, right_sensor=right, swap=swap, level=config.level,
            rollouts=config.rollouts, videos=1 if arm == "V+T" else 0, out=str(out / "score"),
        )  # fmt: skip
        reports.append(score(scoring))
    say("5/5", "report")
    page = draw_demo_page(reports, next(out.glob("score/VT_*/seed_*.png")), out / "page.png")
    arms = {report.arm: report.as_dict() for report in reports}
    write_json(
        out / "wiping.json", {"level": config.level, "label": "smoke, no claim", "arms": arms} | provenance()
    )
    print(table(reports))
    return page


def _train_arguments(config: DemoConfig, out: Path) -> list[str]:
    return [
        "policy=pi05_uniforce", "policy.size=tiny", "policy.device=cpu", "dataset.repo_id=local/demo",
        f"dataset.root={out / 'view'}", f"steps={config.train_steps}", "batch_size=8", "num_workers=0",
        "log_freq=5", f"save_freq={config.train_steps}", f"output_dir={out / 'train'}",
    ]  # fmt: skip


def _start_over(out: Path) -> None:
    """Empty an earlier demo's folder.

    Raises:
        ContractError: a folder that holds something else.
    """
    if out.exists() and any(out.iterdir()) and not (out / MARKER).is_file():
        do = f"Name a new folder, or remove it yourself: it holds no {MARKER}."
        raise ContractError(expected("out", "an empty folder or an earlier demo", str(out), do))
    shutil.rmtree(out, ignore_errors=True)
    write_json(out / MARKER, provenance())


@command(DemoConfig)
def main(config: DemoConfig) -> int:
    """Entry of ``uniforce demo``."""
    logging.basicConfig(level=logging.WARNING)
    os.environ.setdefault("HF_HUB_OFFLINE", "1")
    start = time.perf_counter()
    page = run(config)
    out = Path(config.out)
    print(
        f"\nDone in {(time.perf_counter() - start) / 60:.1f} minutes (n = {config.rollouts}: smoke, no claim)."
    )
    print(f"  picture page   {page}")
    print(f"  video          {next(out.glob('score/VT_*/seed_*.mp4'))}")
    print(f"  demos          {out / 'demos'}   (LeRobot v3 dataset)")
    print(f"  trained        {out / 'train' / 'checkpoints' / 'last'}")
    print(f"  scores         {out / 'wiping.json'}")
    return 0
