"""Faults that end LeRobot's rollout, and how soon the arm rests: fingers, cameras, arm, hand, policy fail."""

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.ledger import Ledger, update
from benchmarks.trust.rollout_trials import KINDS, HOLD_s, Trial
from uniforce_cli.boundary import command
from uniforce_vtla import options
from uniforce_vtla.arguments import choose

# of a program and of each trial, on a starved machine; usual are 15 and 9
START_s, TRIAL_s = 120.0, 120.0


@dataclass
class RolloutFaultsConfig:
    """Break what LeRobot's rollout needs while it moves the arm; see when the arm rests and what is said.

    Example: python -m benchmarks.trust.rollout_faults times=10 out=docs/results/trust.json
    """

    times: options.Count = 10  # trials of each kind
    only: str = ""  # kinds, comma between them; all when empty
    # folder of the single trials; a run that was ended goes on from there
    rows: str = "outputs/rollout_faults"
    out: str = "outputs/trust.json"  # the result file; only its key ``rollout_faults`` changes


def attempt(name: str, times: int, folder: Path) -> list[Trial]:
    """Run what the folder lacks of a kind in a program of its own; one that hangs is a trial too."""
    rows = Ledger(folder)
    folder.mkdir(parents=True, exist_ok=True)
    while lacks := times - len(rows.read(name)):
        program = [
            sys.executable,
            "-m",
            "benchmarks.trust.rollout_trials",
            name,
            str(times),
            str(folder),
        ]
        # a group of its own: a trial that is killed must not leave its stand-ins
        with (
            (folder / f"{name}.log").open("a") as said,
            subprocess.Popen(program, stdout=said, stderr=said, start_new_session=True) as child,
        ):
            try:
                code = child.wait(START_s + lacks * TRIAL_s)
            except subprocess.TimeoutExpired:
                os.killpg(child.pid, signal.SIGKILL)
                hang = Trial(name, "hang", "no end", float("inf"), float("inf"))
                rows.add(name, vars(hang))
                continue
        if code:
            raise RuntimeError(
                f"{name}: expected trials, got exit code {code}. Read {folder / name}.log."
            )
    return [Trial(**row) for row in rows.read(name)]


def summarise(own: list[Trial]) -> dict[str, Any]:
    """Return a kind's line of the result."""
    return {
        "trials": len(own),
        "named_right": sum(row.named in KINDS[row.kind].names for row in own),
        "held": sum(row.hold_s <= HOLD_s for row in own),
        "worst_hold_s": max(row.hold_s for row in own),
        "worst_learnt_s": max(row.learnt_s for row in own),
        "starved": sum(row.starved for row in own),
    }


@command(RolloutFaultsConfig)
def main(config: RolloutFaultsConfig) -> int:
    """Run the trials, write the table, print what went wrong; 1 where anything did."""
    names = list(choose(KINDS, config.only))
    found = {
        name: attempt(name, config.times, Path(config.rows)) for name in tqdm(names, desc="kinds")
    }
    path = update(
        Path(config.out), "rollout_faults", {name: summarise(own) for name, own in found.items()}
    )
    rows = [row for own in found.values() for row in own]
    wrong = [row for row in rows if not row.is_right]
    for row in wrong:
        print(f"{row.kind}: {row.named or 'nothing'}, held after {row.hold_s} s. {row.message}")
    print(
        f"{len(rows) - len(wrong)} of {len(rows)} trials right (named, held ≤ {HOLD_s} s); written to {path}"
    )
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
