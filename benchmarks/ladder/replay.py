"""Roll a few scenes of a committed row out once more with the shipped policy, and compare how they ended.

On one machine a scene ends the same to the last digit. Another processor rounds otherwise, and a scene at the edge
of its band then ends the other way: 18 of 24 scenes of S0 ended alike on an Intel and on the AMD that scored them.
So what is judged is whether clean wipes are lost or won in one direction, beyond chance.
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
    """Roll out the first scenes of a row in which the shipped policy acted, and compare with the committed outcomes.

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
    planned = {entry.name: entry for part in SHIPPED_IN for entry in PARTS[part]}
    fit = {
        name: e
        for name, e in planned.items()
        if (e.checkpoints, len(e.worn), e.calibrated) == ("vt", 1, False)
    }
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
    before = acted_in(
        committed(read_object(Path(config.results), ContractError), config.row), config.scenes
    )
    one = score_config(entry, entry.worn[0], rollouts=1, out=config.work)
    scenes = [replace(one, arm=f"{entry.name} {seed}", first_seed=seed) for seed in before]
    return {
        seed: (code, report.rows[0].code)
        for (seed, code), report in zip(
            before.items(), score_arms(scenes, config.workers), strict=True
        )
    }


@command(ReplayCommand)
def main(config: ReplayCommand) -> int:
    found = replayed(config)
    for seed, (then, now) in found.items():
        print(f"scene {seed}: {then} as committed, {now} now")
    alike = sum(then == now for then, now in found.values())
    clean = [[code == CLEAN for code in codes] for codes in zip(*found.values(), strict=True)]
    p = mcnemar(*clean).p_value
    verdict = "DIFFERS FROM" if p < MAX_CHANCE else "agrees with"
    print(
        f"replay of {config.row} {verdict} {config.results}: {alike} of {len(found)} scenes end alike,"
    )
    print(f"clean {sum(clean[0])} then and {sum(clean[1])} now (p = {p:.2g})")
    return 1 if p < MAX_CHANCE else 0


if __name__ == "__main__":
    sys.exit(main())
