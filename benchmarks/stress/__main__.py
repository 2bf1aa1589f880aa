"""Screen the operators, roll them out, draw the page."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.screen import against, screen_cell
from lerobot_env_uniforce_wiping import LEVELS, level_hash
from uniforce_cli.boundary import Level, command, one_thread
from uniforce_vtla.options import Count, OutFile, Seed, Text, Workers, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead


@dataclass
class StressCommand:
    """Ask of every operator and dose what would be read of a press of 6 N.

    Example: python -m benchmarks.stress sensors=tactip:1,uskin:2
    """

    sensors: Text = "tactip:1,uskin:2,gelsight:2"  # worn on the right finger, comma between them
    level: Level = "touch"
    scenes: Count = 2  # per cell
    first_seed: Seed = 39_700  # development scenes
    workers: Workers = 2
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


@command(StressCommand)
def main(config: StressCommand) -> None:
    """Entry of ``python -m benchmarks.stress``."""
    rows = screen(config)
    for sensor, operators in rows.items():
        print(f"{sensor}: 6 N are read as {operators['none']['press_read_at_6_N']:.2f} N; with the fault, N more:")
        for name, cells in operators.items():
            if name != "none":
                said = "  ".join(f"{cell['dose']:g}: {cell['press_error_N']:+.2f}" for cell in cells[1:])
                print(f"  {name:20} [{OPERATORS[name].unit}] {said}")
    content = {"level": config.level, "level_hash": level_hash(LEVELS[config.level]), "screened": rows}
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
