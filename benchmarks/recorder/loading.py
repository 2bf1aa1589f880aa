"""Recorded data as LeRobot takes it: its stock dataset class reads it, its trainer trains on it."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.recorder.session import environment
from uniforce_datasets.source import read_source

STEPS = 20
STEPS_TAKE_s = 1200.0  # on a starved machine
SLOTS = "policy.touch.slots={touch0: right, touch1: left}"


def load_in_stock_lerobot(root: Path, first: int = 0) -> dict[str, Any]:
    """Read the first and last frame of episodes from ``first`` on with LeRobot's class alone."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("local/trial", root=root, revision="local", video_backend="pyav")
    episodes = read_source(root).episodes
    for episode in episodes[first:]:
        for row in (episode.start, episode.start + episode.length - 1):
            assert int(dataset[row]["episode_index"]) == episode.index, (
                f"row {row} is of another episode"
            )
    return {
        "loads_in_stock_lerobot": dataset.num_episodes == len(episodes),
        "episodes_loaded": len(episodes[first:]),
    }


def train_a_little(root: Path, out: Path) -> dict[str, Any]:
    """Train the tiny policy for 20 steps by ``uniforce train``, on the recorded videos."""
    done = out / "trained.json"
    if done.is_file():
        found: dict[str, Any] = json.loads(done.read_text())
        return found
    run = out / f"run{len(list(out.glob('run*')))}"  # LeRobot wants a folder that isn't there
    arguments = [
        "policy=pi05_uniforce", "policy.size=tiny", "policy.device=cpu", SLOTS,
        "dataset.repo_id=local/trial", f"dataset.root={root}", "dataset.video_backend=pyav",
        "batch_size=2", "num_workers=0", "log_freq=5",
        f"steps={STEPS}", f"save_freq={STEPS}", f"output_dir={run}",
    ]  # fmt: skip
    program = "import sys; from uniforce_cli.train import main; sys.exit(main())"
    command = [sys.executable, "-c", program, *arguments]
    out.mkdir(parents=True, exist_ok=True)
    with (out / "train.log").open("w") as log:
        into: dict[str, Any] = {"stdout": log, "stderr": subprocess.STDOUT}
        ended = subprocess.run(
            command, **into, env=environment(), timeout=STEPS_TAKE_s, check=False
        )
    losses = [float(loss) for loss in re.findall(r"loss:([\d.]+)", (out / "train.log").read_text())]
    saved = (run / "checkpoints" / "last" / "pretrained_model" / "model.safetensors").is_file()
    result = {
        "trained_steps": STEPS if saved and not ended.returncode else 0,
        "training_losses": losses,
    }
    if saved:
        done.write_text(json.dumps(result))
    return result
