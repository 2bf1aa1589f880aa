"""Roll a few scenes of a committed row out once more, and compare how they ended.

On one machine a scene ends the same to the last digit. Another processor rounds otherwise, and a
scene at the edge of its band then ends the other way: 18 of 24 scenes of S0 ended alike on an Intel
and on the AMD that scored them. So what is judged is whether clean wipes are lost or won in one
direction, beyond chance.
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from benchmarks.ladder.__main__ import CLEAN, codes, named_rows, score_config
from benchmarks.ladder.plan import PARTS, Entry
from uniforce_cli.boundary import command
from uniforce_cli.score import score_arms
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.statistics import mcnemar
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Count, FilePath, OutFolder, Text, Workers

MAX_CHANCE = 0.01  # exact McNemar test: below it the replay differs
SHIPPED_IN = ("ladder", "arms")  # parts in which training seed 0 of V+T is the shipped policy


@dataclass
class ReplayCommand:
    """Roll out the first scenes of a row in which the shipped policy acted, and compare.

    Example: python -m benchmarks.ladder.replay row=S1 scenes=3
    """

    row: Text = "S0"  # as in the plan; of V+T, uncalibrated
    scenes: Count = 3
    results: FilePath = "docs/results/wiping.json"
    workers: Workers = 2
    work: OutFolder = "outputs/ladder_replay"


def committed(results: dict[str, Any], name: str) -> dict[str, Any]:
    """Return a row of ``wiping.json``; ContractError: it holds none of that name."""
    rows = dict(named_rows(results))
    if name not in rows:
        raise ContractError(expected("row", " | ".join(rows), name, "Name one of them."))
    return rows[name]


def entry_of(name: str) -> Entry:
    """Return the plan's row; ContractError: the shipped policy alone can't act it."""
    fit = {}
    for part in SHIPPED_IN:
        for entry in PARTS[part]:
            if entry.checkpoints == "vt" and len(entry.worn) == 1 and not entry.calibrated:
                fit[entry.name] = entry
    if name not in fit:
        raise ContractError(
            expected("row", " | ".join(fit), name, "Others need checkpoints or calibrations.")
        )
    return fit[name]


def acted_in(row: dict[str, Any], count: int) -> dict[int, str]:
    """Return the first scenes in which training seed 0 acted, and the code of how each ended."""
    turns = len(row["clean_by_training_seed"])
    return dict(list(codes(row).items())[::turns][:count])


def replayed(config: ReplayCommand) -> dict[int, tuple[str, str]]:
    """Return scene → how it ended then and how it ends now."""
    entry = entry_of(config.row)
    results = read_object(Path(config.results), ContractError)
    before = acted_in(committed(results, config.row), config.scenes)
    one = score_config(entry, entry.worn[0], rollouts=1, out=config.work)
    scenes = [replace(one, arm=f"{entry.name} {seed}", first_seed=seed) for seed in before]
    found = {}
    for seed, report in zip(before, score_arms(scenes, config.workers), strict=True):
        found[seed] = before[seed], report.rows[0].code
    return found


@command(ReplayCommand)
def main(config: ReplayCommand) -> int:
    found = replayed(config)
    alike = 0
    clean_then = []
    clean_now = []
    for seed, (then, now) in found.items():
        print(f"scene {seed}: {then} as committed, {now} now")
        alike += then == now
        clean_then.append(then == CLEAN)
        clean_now.append(now == CLEAN)
    p = mcnemar(clean_then, clean_now).p_value
    verdict = "DIFFERS FROM" if p < MAX_CHANCE else "agrees with"
    ended = f"{alike} of {len(found)} scenes end alike,"
    print(f"replay of {config.row} {verdict} {config.results}: {ended}")
    print(f"clean {sum(clean_then)} then and {sum(clean_now)} now (p = {p:.2g})")
    return int(p < MAX_CHANCE)


if __name__ == "__main__":
    sys.exit(main())
