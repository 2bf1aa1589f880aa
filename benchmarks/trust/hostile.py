"""The robot against every fault of the stand-in; a trial that is there already isn't run again."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.ledger import update
from benchmarks.trust.attempts import run_trials, tally
from benchmarks.trust.hostile_trials import RIGHT_NAMES, HOLD_s, Trial
from uniforce_cli.boundary import command
from uniforce_vtla.arguments import choose

HANG_s = 180.0  # without a new row; a trial takes 4 to 15 s, on a starved machine five times that


@dataclass
class HostileConfig:
    """Break the stand-in of the arm in every named way while it moves; see when arm and hand rest.

    Example: python -m benchmarks.trust.hostile times=10 out=docs/results/trust.json
    """

    times: int = 10  # trials of each fault
    only: str = ""  # faults, comma between them; all when empty
    # folder of the single trials; a run that was ended goes on from there
    rows: str = "outputs/hostile"
    out: str = "outputs/trust.json"  # the result file; only its key ``hostile_faults`` changes


def attack(faults: Sequence[str], times: int, folder: Path) -> list[Trial]:
    """Run what is lacking and return all trials; one that hangs is a trial too."""
    rows = run_trials("benchmarks.trust.hostile_trials", faults, times, folder, HANG_s)
    return [Trial(**row) for row in rows]


def summarise(trials: Sequence[Trial]) -> dict[str, dict[str, Any]]:
    """Return a line per fault."""
    found = tally(trials)
    for one in trials:
        line = found[one.kind]
        fingers_mm = round(1000 * one.fingers_m, 2)
        line["worst_fingers_mm"] = max(line.get("worst_fingers_mm", 0.0), fingers_mm)
        line["sent_after"] = line.get("sent_after", 0) + one.sent_after
    return found


@command(HostileConfig)
def main(config: HostileConfig) -> int:
    """Run the trials, write the table, print what went wrong; 1 where anything did."""
    trials = attack(list(choose(RIGHT_NAMES, config.only)), config.times, Path(config.rows))
    path = update(Path(config.out), "hostile_faults", summarise(trials))
    wrong = [trial for trial in trials if not trial.is_right]
    for one in wrong:
        print(
            f"{one.kind}: {one.named or 'nothing'}, held after {one.hold_s} s, known after "
            f"{one.learnt_s} s, fingers {1000 * one.fingers_m:.1f} mm. {one.message}"
        )
    right = f"{len(trials) - len(wrong)} of {len(trials)} trials right"
    print(f"{right} (named, held and known ≤ {HOLD_s} s); written to {path}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
