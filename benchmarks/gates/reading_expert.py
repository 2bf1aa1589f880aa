"""How well any policy could wipe with a sensor: the expert's law on what the frozen head reads.

The hand holds the grip, so the law needs the shear alone. A policy that feels newtons
can't win back what a sensor loses here against the demonstrations' TacTip.
"""

import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from joblib import delayed

from benchmarks.calibrations import Fit, calibration_folder, units
from benchmarks.ledger import played, update
from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.readings import ReadsWorn, shipped_reader
from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import Script, run_script
from uniforce_cli.boundary import Gripper, Level, command, one_thread, worker_process
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import SensorError
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.options import Count, OutFile, OutFolder, Seed, Text, Workers
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration


@dataclass(frozen=True)
class Reader:
    """Sensors that the right finger wears, in turns by scene, and how they were fitted."""

    worn: tuple[str, ...]
    fit: Fit = ""


READERS: dict[str, Reader] = {
    "true wrench of one finger": Reader(()),
    "TacTip 1": Reader(("tactip",)),
    "TacTip, another in every scene": Reader(("tactip:any",)),
    "uSkin, another in every scene": Reader(("uskin:any",)),
    "GelSight, another in every scene": Reader(("gelsight:any",)),
    "TacTips weighed through the tool": Reader(units("tactip"), "tool"),
    "uSkins calibrated by grasps": Reader(units("uskin"), "grasps"),
    "uSkins weighed through the tool": Reader(units("uskin"), "tool"),
    "GelSights calibrated by grasps": Reader(units("gelsight"), "grasps"),
    "GelSights weighed through the tool": Reader(units("gelsight"), "tool"),
}


@dataclass
class ReadingExpertCommand:
    """Let the expert wipe by what the head reads of each sensor; count clean wipes.

    Example: python -m benchmarks.gates.reading_expert out=docs/results/reading_expert.json
    """

    level: Level = "touch"
    gripper: Gripper = "hand"  # of the scene
    scenes: Count = 60  # the same for every reader
    first_seed: Seed = BLOCKS["reading expert"].start  # of them
    only: Text = ""  # readers, comma between them; all when empty
    workers: Workers = 2
    # calibrations, and episodes so far: run it again to go on
    work: OutFolder = "outputs/reading_expert"
    out: OutFile = "outputs/reading_expert.json"  # the result file; its key is the gripper's name


@dataclass(frozen=True)
class Row:
    """One episode."""

    cell: str  # the reader's name
    seed: int
    worn: str
    clean: bool
    outcome: str
    in_band_share: float
    press_N: float  # mean while it slides


def calibration(worn: str, fit: Fit, work: Path) -> Calibration:
    """Return a unit's calibration; it is made where the folder has none."""
    tokenizer = Tokenizer.from_pretrained()
    return Calibration.load(calibration_folder(worn, fit, work), tokenizer.hash)


def play(name: str, level: str, gripper: str, seed: int, turn: int, work: Path) -> Row:
    """Play one episode of a reader; a frame that can't be read, or a lost tool, ends it."""
    worker_process()
    reader = READERS[name]
    if not reader.worn:
        return _played(
            name, WipeEnv(level, drawn=(), gripper=gripper), WipeExpert("right"), seed, ""
        )
    worn = reader.worn[turn % len(reader.worn)]
    fitted = calibration(worn, reader.fit, work) if reader.fit else None
    expert = ReadsWorn("right", *shipped_reader(), fitted)
    return _played(
        name,
        WipeEnv(level, right_sensor=worn, drawn=("right",), gripper=gripper),
        expert,
        seed,
        worn,
    )


def _played(name: str, env: WipeEnv, script: Script, seed: int, worn: str) -> Row:
    try:
        result = run_script(env, script, seed)
    except SensorError as error:
        return Row(name, seed, worn, False, f"aborted: {error}", 0.0, 0.0)
    press_N = float(result.metrics.get("press_mean_N", np.nan))
    return Row(
        name,
        seed,
        worn,
        result.clean,
        result.outcome,
        float(result.metrics["in_band_share"]),
        press_N,
    )


def summary(rows: list[dict[str, Any]], seeds: range) -> dict[str, Any]:
    """Return a line per reader: clean wipes with their interval, by scene and by what was worn."""
    by_reader = defaultdict[str, list[dict[str, Any]]](list)
    for row in rows:
        if row["seed"] in seeds:
            by_reader[row["cell"]].append(row)
    found = {}
    for name in (name for name in READERS if name in by_reader):
        own = sorted(by_reader[name], key=lambda row: row["seed"])
        clean = sum(row["clean"] for row in own)
        interval = wilson(clean, len(own))
        presses = [row["press_N"] for row in own if np.isfinite(row["press_N"])]
        found[name] = {
            "n": len(own),
            "clean": clean,
            "wilson95": [interval.low, interval.high],
            "in_band_share": float(np.mean([row["in_band_share"] for row in own])),
            "press_N": float(np.mean(presses)) if presses else None,
            "press_sd_N": float(np.std(presses)) if presses else None,
            "by_seed": "".join("C" if row["clean"] else row["outcome"][0] for row in own),
        }
    return found


def _episodes(config: ReadingExpertCommand, seeds: range) -> Iterator[tuple[str, int, Any]]:
    for turn, seed in enumerate(seeds):
        for name in choose(READERS, config.only):
            job = delayed(play)(name, config.level, config.gripper, seed, turn, Path(config.work))
            yield name, seed, job


@command(ReadingExpertCommand)
def main(config: ReadingExpertCommand) -> None:
    """Fit what is lacking, play what is lacking, write the table."""
    one_thread()
    for reader in READERS.values():
        for worn in reader.worn if reader.fit else ():
            calibration(worn, reader.fit, Path(config.work))
    seeds = range(config.first_seed, config.first_seed + config.scenes)
    ledger = Path(config.work) / f"{config.level}_{config.gripper}.jsonl"
    found = summary(played(ledger, _episodes(config, seeds), config.workers), seeds)
    for name, line in found.items():
        low, high = line["wilson95"]
        share = f"[{low:.2f}, {high:.2f}]  in band {line['in_band_share']:.2f}"
        print(f"{name:36} {line['clean']:3}/{line['n']} {share}")
    content = {"level": config.level, "seeds": [seeds[0], seeds[-1]], "readers": found}
    print(f"written to {update(Path(config.out), config.gripper, content)}")


if __name__ == "__main__":
    sys.exit(main())
