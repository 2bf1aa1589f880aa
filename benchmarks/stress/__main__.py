"""Screen the operators, roll them out, draw the page."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.scene_blocks import BLOCKS
from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.rollouts import Arm, cells_of, near_cliffs, roll_policies, roll_readers, summarise
from benchmarks.stress.screen import against, screen_cell
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command, one_thread
from uniforce_cli.score_settings import ScoreConfig
from uniforce_vtla.options import Count, FilePath, FolderPath, OutFile, OutFolder, Policies, Seed, Text, Workers, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead


@dataclass
class StressCommand:
    """Ask of every operator and dose what would be read of a press of 6 N; then roll out what is near a cliff.

    Example: python -m benchmarks.stress sensors=tactip:1,uskin:2
    Then: python -m benchmarks.stress part=rollouts policy=arms/vt/seed0,arms/vt/seed1 rollouts=40
    """

    part: Literal["screen", "rollouts"] = "screen"
    sensors: Text = "tactip:1,uskin:2"  # worn on the right finger, comma between them; rollouts: the policy's own first
    level: Level = "touch"
    scenes: Count = 2  # screen: per cell
    first_seed: Seed = 39_700  # screen: development scenes
    policy: Policies = "shipped"  # rollouts: checkpoint folders that take turns
    calibrations: FolderPath = ""  # rollouts: of exchanged sensors, uskin-2 …; "" = they wear none
    rollouts: Count = 40  # scenes, the same for every cell
    only: Text = ""  # rollouts: just these operators, comma between them
    workers: Workers = 2
    work: OutFolder = "outputs/stress"  # episodes so far: run it again to go on
    screened: FilePath = ""  # rollouts: the screen's result; "" = WORK/screen.json
    out: OutFile = "outputs/stress/screen.json"


def _cell(level: str, words: str, first: int, scenes: int) -> dict[str, Any]:
    one_thread()
    return screen_cell(
        level, words, range(first, first + scenes), Tokenizer.from_pretrained(), ForceHead.from_pretrained()
    )


def screen(config: StressCommand) -> dict[str, Any]:
    """Return a row per sensor, operator and dose."""
    cells = [(sensor, "none", 0.0, sensor) for sensor in split(config.sensors)]
    for sensor in split(config.sensors):
        for name, operator in OPERATORS.items():
            for dose in (operator.benign, *operator.doses):
                if (words := worn_with(operator, sensor, dose)) is not None:
                    cells.append((sensor, name, dose, words))
    jobs = [delayed(_cell)(config.level, words, config.first_seed, config.scenes) for *_, words in cells]
    found = list(tqdm(Parallel(config.workers, return_as="generator")(jobs), total=len(jobs), desc="cells"))
    usual = {sensor: cell for (sensor, name, *_), cell in zip(cells, found, strict=True) if name == "none"}
    rows: dict[str, Any] = {sensor: {"none": usual[sensor]} for sensor in usual}
    for (sensor, name, dose, _), cell in zip(cells, found, strict=True):
        if name != "none":
            cell |= {"dose": dose, "press_error_N": against(cell, usual[sensor])}
            rows[sensor].setdefault(name, []).append(cell)
    return rows


def roll_out(config: StressCommand) -> dict[str, Any]:
    """Return, per arm and for the experts that read its sensor, counts and breaking doses."""
    screened = json.loads(Path(config.screened or Path(config.work) / "screen.json").read_text())["screened"]
    seeds = range(BLOCKS["stress"].start, BLOCKS["stress"].start + config.rollouts)
    usual = ScoreConfig(
        policy=config.policy, level=config.level, rollouts=config.rollouts, first_seed=seeds.start, videos=0,
        out=config.work,
    )  # fmt: skip
    found: dict[str, Any] = {}
    for sensor in split(config.sensors):
        near = near_cliffs(screened[sensor])
        doses = {name: near[name] for name in split(config.only) or near}
        folder = Path(config.calibrations, sensor.replace(":", "-"))
        worn = str(folder) if config.calibrations and folder.is_dir() else ""
        cells = cells_of(Arm(f"policy on {sensor}", sensor, worn), doses)
        readers = cells_of(Arm(f"expert reads {sensor}", sensor), doses)
        found[cells[0].name] = summarise(cells, roll_policies(cells, usual, config.workers))
        path = Path(config.work) / "reading_experts.jsonl"
        found[readers[0].name] = summarise(readers, roll_readers(readers, config.level, seeds, config.workers, path))
    return found


@command(StressCommand)
def main(config: StressCommand) -> None:
    """Entry of ``python -m benchmarks.stress``."""
    content: dict[str, Any] = {"level": config.level, "level_hash": level_hash(LEVELS[config.level])}
    if config.part == "screen":
        content["screened"] = rows = screen(config)
        _print_screen(rows)
    else:
        content["arms"] = arms = roll_out(config)
        for name, operators in arms.items():
            print(f"{name}: {operators['']['clean']} of {operators['']['n']} clean without a fault")
            for operator, row in operators.items():
                if operator:
                    clean = "  ".join(f"{dose:g}: {k}" for dose, k in zip(row["doses"], row["clean"], strict=True))
                    print(f"  {operator:20} benign {row['benign']}  {clean}  breaks at {row['breaking_dose']}")
    print(f"written to {write_json(Path(config.out), content | provenance())}")


def _print_screen(rows: dict[str, Any]) -> None:
    for sensor, operators in rows.items():
        print(f"{sensor}: 6 N are read as {operators['none']['press_read_at_6_N']:.2f} N; with the fault, N more:")
        for name, cells in operators.items():
            if name != "none":
                said = "  ".join(f"{cell['dose']:g}: {cell['press_error_N']:+.2f}" for cell in cells[1:])
                print(f"  {name:20} [{OPERATORS[name].unit}] {said}")


if __name__ == "__main__":
    sys.exit(main())
