"""Damage datasets and checkpoints in every named way, see what refuses them: ``python -m benchmarks.trust.damage``."""

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
    depths = ("full",) if damage.of == "checkpoint" else ("full", "quick")
    lines = {verify: damage.refused(whole, folder / verify, verify) for verify in depths}
    for verify in lines:
        shutil.rmtree(folder / verify)
    said = {
        verify: _verdict(lines.get(verify, lines["full"]), damage.said)
        for verify in ("full", "quick")
    }
    copy = str(folder / "full" / whole.name)  # of this run, so no part of a message
    message = (lines["full"] or "").replace(f"{copy}{os.sep}", "").replace(copy, "ROOT")
    return {"kind": damage.name, "of": damage.of, **said, "message": message}


def _verdict(line: str | None, said: str) -> str:
    if line is None:
        return "accepted"
    return "refused" if said in line and "\n" not in line else "refused, not named"


def seconds(folder: Path, frames: int) -> dict[str, Any]:
    """Return how long checking 50 episodes takes (quick: medians of three), and their size."""
    root = record_synthetic(folder / "long", EPISODES, frames)
    size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
    quick = np.median([_once(root, "quick") for _ in range(TIMES)], axis=0).tolist()
    full = _once(root, "full")
    times = {"quick_s_50_episodes": quick[0], "quick_cpu_s_50_episodes": quick[1]}
    times |= {"full_s_50_episodes": full[0], "full_cpu_s_50_episodes": full[1]}
    return times | {
        "frames_per_episode": frames,
        "size_MB": size / 1e6,
        "load_average": os.getloadavg()[0],
    }


def _once(root: Path, verify: str) -> tuple[float, float]:
    """Return the seconds one check took, on the clock and of all cores."""
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    check_dataset(root, verify)
    return time.perf_counter() - began_s, time.process_time() - began_cpu_s


def attack(frames: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        whole = record_whole(folder)
        check_dataset(whole["dataset"], "full")
        every = tqdm((*DATASET_DAMAGES, *CHECKPOINT_DAMAGES), desc="damages")
        rows = [try_damage(damage, whole.get(damage.of, damage.sound), folder) for damage in every]
        timed = seconds(folder, frames)
    counts = {f"accepted_{v}": sum(row[v] == "accepted" for row in rows) for v in ("full", "quick")}
    unnamed = sum("refused, not named" in row.values() for row in rows)
    kinds = {"kinds": len(rows), "kinds_of": dict(Counter(row["of"] for row in rows))}
    return kinds | counts | {"not_named": unnamed} | timed | {"rows": rows}


@command(DamageConfig)
def main(config: DamageConfig) -> int:
    """Do all damage, write the table, print what was accepted; 1 where the full check accepted any."""
    logging.disable(logging.WARNING)  # copies without hashes say so
    found = attack(config.frames)
    path = update(Path(config.out), "damage", found)
    for row in found["rows"]:
        if {row["full"], row["quick"]} != {"refused"}:
            print(
                f"{row['of']}, {row['kind']}: full {row['full']}, quick {row['quick']}. {row['message']}"
            )
    accepted = f"{found['accepted_full']} accepted by full, {found['accepted_quick']} by quick"
    print(
        f"{found['kinds']} kinds, {accepted}; quick {found['quick_s_50_episodes']:.1f} s; written to {path}"
    )
    return int(bool(found["accepted_full"] or found["not_named"]))


if __name__ == "__main__":
    sys.exit(main())
