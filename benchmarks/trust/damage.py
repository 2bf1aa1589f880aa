"""Damage datasets and checkpoints in every named way, and see what refuses them."""

import logging
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.ledger import update
from benchmarks.trust.damaged_checkpoints import CHECKPOINT_DAMAGES
from benchmarks.trust.damaged_datasets import DATASET_DAMAGES, record_whole
from benchmarks.trust.injuries import Damage
from uniforce_cli.boundary import command
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.synthetic import record_synthetic

EPISODES = 50
TIMES = 3


@dataclass
class DamageConfig:
    """Count damages that loading accepts, and time the quick and full check of 50 episodes.

    Example: python -m benchmarks.trust.damage out=docs/results/trust.json
    """

    frames: int = 100  # of each of the 50 episodes that are timed; 600 are 20 s
    out: str = "outputs/trust.json"  # the result file; only its key ``damage`` changes


def try_damage(damage: Damage, whole: Path, folder: Path) -> dict[str, Any]:
    """Return the table's row of one kind; checkpoints are always checked in full."""
    row = {"kind": damage.name, "of": damage.of}
    line = damage.refused(whole, folder / "full", "full")
    row["full"] = row["quick"] = _verdict(line, damage.said)
    copy = str(folder / "full" / whole.name)  # of this run, so no part of a message
    row["message"] = (line or "").replace(f"{copy}{os.sep}", "").replace(copy, "ROOT")
    shutil.rmtree(folder / "full")
    if damage.of != "checkpoint":
        row["quick"] = _verdict(damage.refused(whole, folder / "quick", "quick"), damage.said)
        shutil.rmtree(folder / "quick")
    return row


def _verdict(line: str | None, said: str) -> str:
    if line is None:
        return "accepted"
    return "refused" if said in line and "\n" not in line else "refused, not named"


def seconds(folder: Path, frames: int) -> dict[str, Any]:
    """Return how long checking 50 episodes takes (quick: medians of three), and their size."""
    root = record_synthetic(folder / "long", EPISODES, frames)
    quick = np.median([_once(root, "quick") for _ in range(TIMES)], axis=0).tolist()
    full = _once(root, "full")
    return {
        "quick_s_50_episodes": quick[0],
        "quick_cpu_s_50_episodes": quick[1],
        "full_s_50_episodes": full[0],
        "full_cpu_s_50_episodes": full[1],
        "frames_per_episode": frames,
        "size_MB": sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) / 1e6,
        "load_average": os.getloadavg()[0],
    }


def _once(root: Path, verify: str) -> tuple[float, float]:
    """Return the seconds one check took, on the clock and of all cores."""
    began_s = time.perf_counter()
    began_cpu_s = time.process_time()
    check_dataset(root, verify)
    return time.perf_counter() - began_s, time.process_time() - began_cpu_s


def attack(frames: int) -> dict[str, Any]:
    rows = []
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        whole = record_whole(folder)
        check_dataset(whole["dataset"], "full")
        for damage in tqdm((*DATASET_DAMAGES, *CHECKPOINT_DAMAGES), desc="damages"):
            rows.append(try_damage(damage, whole.get(damage.of, damage.sound), folder))
        timed = seconds(folder, frames)
    return {
        "kinds": len(rows),
        "kinds_of": dict(Counter(row["of"] for row in rows)),
        "accepted_full": sum(row["full"] == "accepted" for row in rows),
        "accepted_quick": sum(row["quick"] == "accepted" for row in rows),
        "not_named": sum("refused, not named" in row.values() for row in rows),
        **timed,
        "rows": rows,
    }


@command(DamageConfig)
def main(config: DamageConfig) -> int:
    """Do all damage, write the table, print what was accepted; 1 if a full check accepted any."""
    logging.disable(logging.WARNING)  # copies without hashes say so
    found = attack(config.frames)
    path = update(Path(config.out), "damage", found)
    for row in found["rows"]:
        if row["full"] != "refused" or row["quick"] != "refused":
            verdicts = f"full {row['full']}, quick {row['quick']}"
            print(f"{row['of']}, {row['kind']}: {verdicts}. {row['message']}")
    accepted = f"{found['accepted_full']} accepted by full, {found['accepted_quick']} by quick"
    quick = f"quick {found['quick_s_50_episodes']:.1f} s"
    print(f"{found['kinds']} kinds, {accepted}; {quick}; written to {path}")
    return int(bool(found["accepted_full"] or found["not_named"]))


if __name__ == "__main__":
    sys.exit(main())
