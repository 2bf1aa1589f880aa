"""Faults that end LeRobot's rollout, and how soon the arm rests: fingers, cameras, arm, policy."""

import sys
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from benchmarks.ledger import update
from benchmarks.trust.attempts import run_trials, tally
from benchmarks.trust.rollout_trials import KINDS, HOLD_s, Trial
from uniforce_cli.boundary import command
from uniforce_vtla import options
from uniforce_vtla.arguments import choose

HANG_s = 240.0  # without a new row: on a starved machine; usual are 15 to start and 9 for a trial


@dataclass
class RolloutFaultsConfig:
    """Break what LeRobot's rollout needs while it moves the arm; see when the arm rests.

    Example: python -m benchmarks.trust.rollout_faults times=10 out=docs/results/trust.json
    """

    times: options.Count = 10  # trials of each kind
    only: str = ""  # kinds, comma between them; all when empty
    # folder of the single trials; a run that was ended goes on from there
    rows: str = "outputs/rollout_faults"
    out: str = "outputs/trust.json"  # the result file; only its key ``rollout_faults`` changes


def attempt(name: str, times: int, folder: Path) -> list[Trial]:
    """Run what the folder lacks of a kind in a program of its own; one that hangs is a trial."""
    rows = run_trials("benchmarks.trust.rollout_trials", [name], times, folder, HANG_s)
    return [Trial(**row) for row in rows]


@command(RolloutFaultsConfig)
def main(config: RolloutFaultsConfig) -> int:
    """Run the trials, write the table, print what went wrong; 1 where anything did."""
    rows: list[Trial] = []
    for name in tqdm(list(choose(KINDS, config.only)), desc="kinds"):
        rows += attempt(name, config.times, Path(config.rows))
    path = update(Path(config.out), "rollout_faults", tally(rows))
    wrong = [row for row in rows if not row.is_right]
    for row in wrong:
        print(f"{row.kind}: {row.named or 'nothing'}, held after {row.hold_s} s. {row.message}")
    right = f"{len(rows) - len(wrong)} of {len(rows)} trials right"
    print(f"{right} (named, held ≤ {HOLD_s} s); written to {path}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
