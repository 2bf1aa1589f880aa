"""Roll faults out: paired scenes, a dose that must not matter beside each, and the counts.

All cells act in the same scenes. Each arm has its expert beside it: for a sensor's faults the one
that reads the faulty sensor, for the scene's faults the one with the true wrench, so that an
impossible cell isn't blamed on the policy.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from joblib import delayed

from benchmarks.ledger import played
from benchmarks.stress.actors import Arm, play
from benchmarks.stress.disturbed import SCENE_OPERATORS
from benchmarks.stress.operators import OPERATORS, Operator, worn_with
from benchmarks.stress.row import Row
from uniforce_vtla.evaluation.statistics import Proportion, non_inferior, wilson

MARGIN = 0.10  # of clean success: what may be lost before a dose counts as breaking
FEWEST = 25  # scenes: of fewer even a dose that costs nothing would have a bound beyond the margin
# a misread press between these is near a cliff; the level fails readings by 15 %, .9 N
NEAR_N = (0.2, 4.0)
ALL_OPERATORS: dict[str, Operator] = {**OPERATORS, **SCENE_OPERATORS}
COUNTED = ("n", "clean", "success", "slippage", "excess_force")
Doses = dict[str, list[float]]  # operator → doses


@dataclass(frozen=True)
class Cell:
    """An arm with a fault; without one, what it is compared with."""

    arm: Arm
    operator: str = ""
    dose: float = 0.0

    @property
    def words(self) -> str:
        """Sensor of the right finger."""
        if self.operator not in OPERATORS:
            return self.arm.sensor
        worn = worn_with(OPERATORS[self.operator], self.arm.sensor, self.dose)
        assert worn is not None
        return worn

    @property
    def benign(self) -> bool:
        """Whether its dose changes nothing; a few scenes show that."""
        return bool(self.operator) and self.dose == ALL_OPERATORS[self.operator].benign

    @property
    def fault(self) -> str:
        """Operator and dose."""
        return f"{self.operator} {self.dose:g}"

    @property
    def name(self) -> str:
        """Arm, operator and dose."""
        return f"{self.arm.name}, {self.fault}" if self.operator else self.arm.name


def near_cliffs(screened: Mapping[str, Any], most: int = 3) -> Doses:
    """Return the doses to roll out: misread about as much as the level forgives, and the named one.

    Args:
        screened: one sensor's rows of stress_screen.json.
        most: doses per operator beside the named one.
    """
    found: Doses = {}
    for name, cells in screened.items():
        if name == "none":
            continue
        errors = {}
        for cell in cells[1:]:
            misread_N = cell["press_error_N"]
            errors[cell["dose"]] = (
                math.inf if misread_N is None else abs(misread_N)
            )  # None: refused
        near = [dose for dose, error_N in errors.items() if NEAR_N[0] <= error_N <= NEAR_N[1]]
        if not near:
            near = list(errors)[-1:]
        wanted = {*near[:most], OPERATORS[name].named}
        doses = [dose for dose in errors if dose in wanted]
        if doses:
            found[name] = doses
    return found


def of_the_scene(most: int = 3) -> Doses:
    """Return the middle doses of a scene's faults, ``most`` of each, at least the named one."""
    side = (max(most, 1) - 1) // 2
    found: Doses = {}
    for name, operator in SCENE_OPERATORS.items():
        found[name] = list(operator.doses[2 - side : 3 + side])
    return found


def cells_of(arm: Arm, doses: Mapping[str, Sequence[float]]) -> list[Cell]:
    """Return an arm's cells: no fault, each operator's benign dose, the doses to roll out."""
    cells = [Cell(arm)]
    for name, wanted in doses.items():
        benign = ALL_OPERATORS[name].benign
        if name in SCENE_OPERATORS or worn_with(OPERATORS[name], arm.sensor, benign) is not None:
            for dose in (benign, *wanted):
                cells.append(Cell(arm, name, dose))
    return cells


def roll(
    cells: Sequence[Cell],
    level: str,
    seeds: range,
    workers: int,
    path: Path,
    benign: int = 4,
    acting: tuple[str, ...] = ("",),
) -> dict[str, dict[int, Row]]:
    """Return cell → scene → row; rows in ``path`` are kept, each new episode is added to it.

    Benign doses, and arms that act in ``few``, act in the first ``benign`` scenes. Arms whose
    names don't begin with one of ``acting`` play no new episode.

    Raises ContractError: another process adds to ``path`` now.
    """
    job = delayed(play)
    episodes = []
    for seed in seeds:
        for c in cells:
            few = c.benign or c.arm.few
            if not c.arm.name.startswith(acting) or (few and seed - seeds.start >= benign):
                continue
            call = job(c.arm, level, c.words, c.operator, c.dose, c.name, seed, seeds.start)
            episodes.append((c.name, seed, call))
    return by_cell([Row(**row) for row in played(path, episodes, workers)], cells, seeds)


def by_cell(rows: Iterable[Row], cells: Sequence[Cell], seeds: range) -> dict[str, dict[int, Row]]:
    """Return cell → scene → row, of these cells and scenes alone."""
    found: dict[str, dict[int, Row]] = {cell.name: {} for cell in cells}
    for row in rows:
        if row.cell in found and row.seed in seeds:
            found[row.cell][row.seed] = row
    return found


def summarise(cells: Sequence[Cell], rows: Mapping[str, Mapping[int, Row]]) -> dict[str, Any]:
    """Return counts per operator of one arm, and the first dose that loses more than the margin.

    ``judged`` is False where scenes are too few to tell; there is no breaking dose then.
    """
    usual = rows[cells[0].name]
    found: dict[str, Any] = {"": counts(usual)}
    for name in dict.fromkeys(cell.operator for cell in cells[1:]):
        benign, *faulty = (cell for cell in cells if cell.operator == name)
        by_dose: dict[str, list[Any]] = {key: [] for key in ("doses", *found[""])}
        lower = []
        judged = True
        breaking_dose = None
        for cell in faulty:
            by_dose["doses"].append(cell.dose)
            for key, count in counts(rows[cell.name]).items():
                by_dose[key].append(count)
            bound = _lower_bound(rows[cell.name], usual)
            lower.append(round(bound, 3))
            judged &= len(rows[cell.name]) >= FEWEST
            if breaking_dose is None and bound < -MARGIN:
                breaking_dose = cell.dose
        unharmed = rows[benign.name]
        found[name] = {
            "unit": ALL_OPERATORS[name].unit,
            **by_dose,
            "lower_bound": lower,
            "benign": counts(unharmed)["clean"],
            "benign_n": len(unharmed),
            "benign_alike": all(_alike(row, usual.get(seed)) for seed, row in unharmed.items()),
            "judged": judged,
            "breaking_dose": breaking_dose if judged else None,
        }
    return found


def counts(rows: Mapping[int, Row]) -> dict[str, float]:
    """Return how many episodes there are, how they ended, and the mean in-band share."""
    found: dict[str, float] = dict.fromkeys(COUNTED, 0)
    for row in rows.values():
        found["n"] += 1
        found["clean"] += row.clean
        found["success"] += row.outcome == "success"
        found["slippage"] += row.slippage
        found["excess_force"] += row.excess_force
    share = sum(row.in_band_share for row in rows.values())
    return found | {"in_band_share": round(share / max(len(rows), 1), 3)}


def repeatability(cells: Sequence[Cell], rows: Mapping[str, Mapping[int, Row]]) -> dict[str, int]:
    """Return how many cells there are, and in how many every other scene agrees with the rest.

    They agree where the 95 % interval of their difference holds zero. To ask that each share lie
    in the other's interval is too much: of two runs of one truth a fifth to a half would not.
    """
    agree = []
    for cell in cells:
        if cell.benign or cell.arm.few:
            continue
        halves: tuple[list[bool], list[bool]] = ([], [])
        for seed, row in rows[cell.name].items():
            halves[seed % 2].append(row.clean)
        if all(halves):
            even = wilson(sum(halves[0]), len(halves[0]))
            odd = wilson(sum(halves[1]), len(halves[1]))
            agree.append(_zero_within(even, odd))
    return {"cells": len(agree), "agree": sum(agree)}


def _zero_within(one: Proportion, other: Proportion) -> bool:
    """Return whether Newcombe's interval of the difference of two shares holds zero."""
    higher, lower = sorted((one, other), key=lambda share: -share.k / share.n)
    p = higher.k / higher.n
    q = lower.k / lower.n
    return p - q <= math.hypot(p - higher.low, lower.high - q)


def mean_corruption_error(arm: Mapping[str, Any], without_touch: Mapping[str, Any]) -> float | None:
    """Return ImageNet-C's mCE: failures over a touchless policy's, mean over operators, or None.

    A sensor's fault doesn't reach a policy without touch: its failures without a fault stand there.
    """
    usual = without_touch.get("")
    ratios = []
    for name, here in arm.items():
        if not name:
            continue
        if name in without_touch:
            there = without_touch[name]
            fails = 1 - sum(there["clean"]) / sum(there["n"])
        else:
            fails = 1 - usual["clean"] / usual["n"]  # type: ignore[index]
        failed = 1 - sum(here["clean"]) / sum(here["n"])
        ratios.append(failed / max(fails, 1e-9))
    return round(sum(ratios) / len(ratios), 3) if ratios else None


def _alike(row: Row, other: Row | None) -> bool:
    return other is not None and (row.clean, row.outcome) == (other.clean, other.outcome)


def _lower_bound(faulty: Mapping[int, Row], usual: Mapping[int, Row]) -> float:
    seeds = sorted(faulty.keys() & usual.keys())
    if not seeds:
        return -1.0  # all may be lost
    with_fault = [faulty[seed].clean for seed in seeds]
    without = [usual[seed].clean for seed in seeds]
    return non_inferior(with_fault, without, MARGIN).lower
