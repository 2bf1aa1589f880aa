"""Roll faults out: a policy and its swapped arm, the expert by the same readings, and the dose that must not matter.

All arms of all cells act in the same scenes. The expert that reads the faulty sensor says what the reading alone costs,
so that an impossible cell isn't blamed on the policy.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from tqdm import tqdm

from benchmarks.stress.operators import OPERATORS, worn_with
from benchmarks.stress.readings import ReadsWorn
from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.episodes import run_script
from uniforce_cli.boundary import one_thread
from uniforce_cli.score import score_arms
from uniforce_cli.score_settings import ScoreConfig
from uniforce_vtla.errors import SensorError
from uniforce_vtla.evaluation.statistics import non_inferior
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

MARGIN = 0.10  # of clean success: what may be lost before a dose counts as breaking
NEAR_N = (0.2, 4.0)  # a misread press between these is near a cliff; the level fails readings by 15 %, .9 N


@dataclass(frozen=True)
class Arm:
    """What acts: a policy's checkpoints on a sensor, and that sensor's calibration."""

    name: str
    sensor: str  # worn right, in words
    calibration: str = ""  # folder


@dataclass(frozen=True)
class Cell:
    """An arm with a fault; without one, what it is compared with."""

    arm: Arm
    operator: str = ""
    dose: float = 0.0

    @property
    def words(self) -> str:
        """What the right finger wears."""
        worn = worn_with(OPERATORS[self.operator], self.arm.sensor, self.dose) if self.operator else self.arm.sensor
        assert worn is not None
        return worn

    @property
    def name(self) -> str:
        """Arm, operator and dose."""
        return f"{self.arm.name}, {self.operator} {self.dose:g}" if self.operator else self.arm.name


def near_cliffs(screened: Mapping[str, Any], most: int = 3) -> dict[str, list[float]]:
    """Return operator → the doses to roll out: those whose misread press is closest to what the level forgives.

    Args:
        screened: one sensor's rows of the screen.
        most: doses per operator.
    """
    found = {}
    for name, cells in screened.items():
        if name == "none":
            continue
        errors = {cell["dose"]: abs(cell["press_error_N"]) for cell in cells[1:]}
        near = [dose for dose, error in errors.items() if NEAR_N[0] <= error <= NEAR_N[1]] or list(errors)[-1:]
        found[name] = near[:most]
    return found


def cells_of(arm: Arm, doses: Mapping[str, Sequence[float]]) -> list[Cell]:
    """Return an arm's cells: without a fault, each operator's benign dose, and the doses to roll out."""
    cells = [Cell(arm)]
    for name, wanted in doses.items():
        if worn_with(OPERATORS[name], arm.sensor, OPERATORS[name].benign) is not None:
            cells += [Cell(arm, name, dose) for dose in (OPERATORS[name].benign, *wanted)]
    return cells


def roll_policies(cells: Sequence[Cell], usual: ScoreConfig, workers: int) -> dict[str, dict[int, bool]]:
    """Return cell → scene → clean, of a policy; episodes of an earlier call are kept."""
    configs = [
        replace(usual, arm=cell.name, right_sensor=cell.words, right_calibration=cell.arm.calibration) for cell in cells
    ]
    reports = score_arms(configs, workers)
    return {
        cell.name: {row.seed: row.clean for row in report.rows} for cell, report in zip(cells, reports, strict=True)
    }


def roll_readers(
    cells: Sequence[Cell], level: str, seeds: range, workers: int, path: Path
) -> dict[str, dict[int, bool]]:
    """Return cell → scene → clean, of the expert that reads the worn sensor; rows in ``path`` are kept."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    done = {(row["cell"], row["seed"]) for row in rows}
    jobs = [
        delayed(_read_episode)(level, cell.name, cell.words, seed)
        for seed in seeds
        for cell in cells
        if (cell.name, seed) not in done
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        for row in tqdm(Parallel(workers, return_as="generator")(jobs), total=len(jobs), desc="reading experts"):
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows.append(row)
    found: dict[str, dict[int, bool]] = {cell.name: {} for cell in cells}
    for row in rows:
        if row["cell"] in found and row["seed"] in seeds:
            found[row["cell"]][row["seed"]] = row["clean"]
    return found


def _read_episode(level: str, cell: str, words: str, seed: int) -> dict[str, Any]:
    one_thread()
    tokenizer, head = _reader()
    env = WipeEnv(level, right_sensor=words, drawn=("right",))
    try:
        clean = run_script(env, ReadsWorn("right", tokenizer, head), seed).clean
    except SensorError:  # the reference is refused: nothing is done, as on a robot
        clean = False
    return {"cell": cell, "seed": seed, "clean": bool(clean)}


@cache
def _reader() -> tuple[Tokenizer, ForceHead]:
    return Tokenizer.from_pretrained(), ForceHead.from_pretrained()


def summarise(cells: Sequence[Cell], clean: Mapping[str, Mapping[int, bool]]) -> dict[str, Any]:
    """Return, per operator of one arm, counts and the breaking dose: the first that loses more than the margin."""
    usual = clean[cells[0].name]
    found: dict[str, Any] = {"": {"n": len(usual), "clean": sum(usual.values())}}
    for name in dict.fromkeys(cell.operator for cell in cells[1:]):
        benign, *faulty = (cell for cell in cells if cell.operator == name)
        rows = [_against(clean[cell.name], usual) for cell in faulty]
        breaking = [cell.dose for cell, row in zip(faulty, rows, strict=True) if row["lower"] < -MARGIN]
        found[name] = {
            "unit": OPERATORS[name].unit,
            "doses": [cell.dose for cell in faulty],
            "clean": [row["clean"] for row in rows],
            "lower_bound": [round(row["lower"], 3) for row in rows],
            "benign": _against(clean[benign.name], usual)["clean"],
            "breaking_dose": breaking[0] if breaking else None,
        }
    return found


def _against(faulty: Mapping[int, bool], usual: Mapping[int, bool]) -> dict[str, Any]:
    seeds = sorted(faulty.keys() & usual.keys())
    found = non_inferior([faulty[s] for s in seeds], [usual[s] for s in seeds], MARGIN)
    return {"clean": sum(faulty.values()), "lower": found.lower}
