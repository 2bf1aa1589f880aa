"""From scored episodes to an arm's line in the table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.rollout import Rollout
from uniforce_vtla.evaluation.statistics import wilson
from uniforce_vtla.keys import OUTCOME_NAMES
from uniforce_vtla.results_file import read_lines

Clean = list[bool]  # clean success, seed by seed
CleanBySeed = Mapping[int, bool]  # of one arm

CONTACT_N = 0.5  # of press: the eraser is on the board


@dataclass(frozen=True)
class EpisodeRow:
    """Row of one episode in ``episodes.jsonl``."""

    seed: int
    outcome: str
    clean: bool
    slippage: bool
    excess_force: bool
    residual: float
    press_mean_N: float
    press_max_N: float
    seconds: float
    think_p50_ms: float
    think_p95_ms: float
    missed_deadlines: int = 0  # calls answered after the action queue ran dry
    in_band_share: float = 0.0  # of the sliding distance, pressed within the limits' band

    @property
    def code(self) -> str:
        """One letter: C clean, s success with an event, f failed grasp, r residual, a aborted."""
        return "C" if self.clean else self.outcome[0]


def row_of(rollout: Rollout) -> EpisodeRow:
    """Return the row of a rollout; of one that ended before its first step all ink is left."""
    result = rollout.result
    trace = rollout.trace
    press = np.asarray(trace.press_N, dtype=np.float64)
    pressing = press[press > CONTACT_N]
    if not pressing.size:
        pressing = np.zeros(1)
    think_ms = rollout.think_ms
    if not len(think_ms):
        think_ms = np.zeros(1)
    return EpisodeRow(
        seed=rollout.seed,
        outcome=result.outcome,
        clean=bool(result.clean),
        slippage=bool(result.slippage),
        excess_force=bool(result.excess_force),
        residual=_last(trace.residual, 1.0),
        press_mean_N=float(pressing.mean()),
        press_max_N=float(press.max(initial=0.0)),
        seconds=_last(trace.time_s, 0.0),
        think_p50_ms=float(np.percentile(think_ms, 50)),
        think_p95_ms=float(np.percentile(think_ms, 95)),
        missed_deadlines=int(rollout.facts.get("missed_deadlines", 0)),
        in_band_share=round(float(result.metrics.get("in_band_share", 0.0)), 4),
    )


def _last(values: np.ndarray, before: float) -> float:
    """Return the last of (n,) values, or what was so before the first."""
    return float(values[-1]) if len(values) else before


def read_rows(path: Path) -> dict[int, EpisodeRow]:
    """Return finished rows of ``append_line`` by seed; ContractError: of another version."""
    try:
        rows = [EpisodeRow(**line) for line in read_lines(path)]
    except (TypeError, ValueError) as error:
        do = "Score into another folder."
        raise ContractError(expected(str(path), "rows of this version", error, do)) from error
    return {row.seed: row for row in rows}


@dataclass(frozen=True)
class ArmReport:
    """Counts of one arm over its seeds."""

    arm: str
    rows: Sequence[EpisodeRow]

    @property
    def n(self) -> int:
        """Number of rollouts."""
        return len(self.rows)

    @property
    def in_band_share(self) -> float:
        """Mean over the rollouts."""
        return sum(row.in_band_share for row in self.rows) / self.n

    @property
    def clean_by_seed(self) -> dict[int, bool]:
        """Whether each rollout was clean, by its scene's seed."""
        return {row.seed: row.clean for row in self.rows}

    def count(self, name: str) -> int:
        """Number of rollouts with outcome or event ``name``."""
        if name in OUTCOME_NAMES:
            return sum(row.outcome == name for row in self.rows)
        return sum(bool(getattr(row, name)) for row in self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Return the arm's entry in ``wiping.json``."""
        names = (*OUTCOME_NAMES, "clean", "slippage", "excess_force")
        counts = {name: self.count(name) for name in names}
        interval = wilson(counts["clean"], self.n)
        return {
            "n": self.n,
            **counts,
            "clean_wilson_95": [interval.low, interval.high],
            "in_band_share": self.in_band_share,
            "seeds": [self.rows[0].seed, self.rows[-1].seed],
            "by_seed": "".join(row.code for row in self.rows),
        }


def table(reports: Sequence[ArmReport]) -> str:
    """Return a Markdown table, one line per arm: k/n with Wilson 95 % intervals, mean in band."""
    counted = ("failed_grasp", "residual", "aborted", "slippage", "excess_force")
    rows = [["arm", "clean success", "success", "in band"]]
    rows[0] += [name.replace("_", " ") for name in counted]
    for report in reports:
        clean = wilson(report.count("clean"), report.n)
        success = wilson(report.count("success"), report.n)
        row = [report.arm, str(clean), str(success), f"{report.in_band_share:.2f}"]
        rows.append(row + [str(report.count(name)) for name in counted])
    lines = [f"| {' | '.join(row)} |" for row in rows]
    lines.insert(1, "|" + "---|" * len(rows[0]))
    return "\n".join(lines)


def whose_turn(scene: int, names: Sequence[str]) -> str:
    """Return which of several training seeds' checkpoints acts in a scene."""
    return names[scene % len(names)]


def paired_clean(first: CleanBySeed, second: CleanBySeed) -> tuple[Clean, Clean]:
    """Return clean success of both arms on the seeds they share, in the order of the seeds."""
    seeds = sorted(first.keys() & second.keys())
    return [first[s] for s in seeds], [second[s] for s in seeds]
