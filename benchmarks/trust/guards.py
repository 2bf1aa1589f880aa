"""Attack the robot's guards: ``python -m benchmarks.trust.guards [episodes=2000] [out=docs/results/trust.json]``.

Tries every bad setting, then drives the whole chain with random limits, states and actions, and counts what was sent.
"""

import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.trust.bad_settings import try_all
from benchmarks.trust.guard_cases import drive
from benchmarks.trust.report import update
from uniforce_vtla.arguments import parse

CHUNK = 100


@dataclass
class GuardsConfig:
    """Count bad settings refused and bad poses sent; a newly found violation is printed with its seed.

    Example: python -m benchmarks.trust.guards episodes=2000 out=docs/results/trust.json
    """

    episodes: int = 2000  # of 50 actions; 2,000 send some 200,000 poses
    seed: int = 0  # the first of the seeds, one for each 100 episodes
    out: str = "outputs/trust.json"  # the result file; only its key ``guards`` changes


def attack(episodes: int, seed: int) -> dict[str, Any]:
    """Return the table's row: settings tried and refused, poses sent, violations."""
    settings = try_all()
    sent, actions = 0, 0
    violations: list[str] = []
    faults: dict[str, int] = {}
    for chunk in tqdm(range(0, episodes, CHUNK), desc="episodes"):
        found = drive(min(CHUNK, episodes - chunk), seed + chunk // CHUNK)
        sent, actions = sent + found["sent"], actions + found["actions"]
        violations += [f"seed {seed + chunk // CHUNK}: {what}" for what in found["violations"]]
        faults = {name: faults.get(name, 0) + found["faults"].get(name, 0) for name in faults | found["faults"]}
    return settings | {
        "actions": actions,
        "sent_cases": sent,
        "violations": len(violations),
        "examples": violations[:10],
        "faults": faults,
    }


def main(argv: list[str] | None = None) -> int:
    """Run the attack, write the row, print it; 1 where anything bad went through."""
    config = parse(GuardsConfig, argv)
    logging.disable(logging.CRITICAL)  # each guard that acts says so, 100,000 times
    row = attack(config.episodes, config.seed)
    path = update(Path(config.out), "guards", row)
    print(
        f"settings: {row['refused']} of {row['tried']} refused; sent {row['sent_cases']:,} poses, "
        f"{row['violations']} violations; written to {path}"
    )
    return int(bool(row["accepted"] or row["violations"]))


if __name__ == "__main__":
    sys.exit(main())
