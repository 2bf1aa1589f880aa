"""Attack the robot's guards: every bad setting, then the whole chain with random inputs."""

import logging
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.ledger import update
from benchmarks.trust.guard_cases import drive
from uniforce_cli.boundary import command
from uniforce_robots.franka.arm import Gains
from uniforce_robots.franka.config import NESTED, UniforceFrankaConfig
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.franka.limits import HARD_LIMITS, HandSettings, Range, StreamSettings
from uniforce_vtla.errors import ContractError

CHUNK = 100


@dataclass
class GuardsConfig:
    """Count bad settings refused and bad poses sent; a new violation is printed with its seed.

    Example: python -m benchmarks.trust.guards episodes=2000 out=docs/results/trust.json
    """

    episodes: int = 2000  # of 50 actions; 2,000 send some 200,000 poses
    seed: int = 0  # the first of the seeds, one for each 100 episodes
    out: str = "outputs/trust.json"  # the result file; only its key ``guards`` changes


NEEDS: dict[type, dict[str, Any]] = {
    GuardLimits: {},
    StreamSettings: {},
    HandSettings: {},
    Gains: {"stiffness_N_m": (800.0, 800.0, 800.0)},
    UniforceFrankaConfig: {},
}


BAD_GAINS: tuple[dict[str, Any], ...] = (
    {"stiffness_N_m": (3000.0,) * 3, "clip_m": (0.05,) * 3},
    # each product is 60 N, but with the hand turned by a right angle 3000 N/m meet 0.05 m
    {"stiffness_N_m": (1200.0, 3000.0, 0.0), "clip_m": (0.05, 0.02, 0.01)},
    {"stiffness_N_m": (100.0,) * 3, "rotation_Nm_rad": (300.0,) * 3, "clip_rad": 0.5},
)


def bad_values(allowed: Range) -> list[Any]:
    """Return values outside a range, and values that are no numbers."""
    outside = [
        allowed.low - 1.0,
        allowed.low - 1e-6,
        allowed.high * 1.01 + 1e-6,
        -abs(allowed.high) - 1.0,
        1e9,
    ]
    if allowed.above:
        outside.append(allowed.low)
    return [math.nan, math.inf, -math.inf, "0.1", None, True, *outside]


def bad_settings() -> Iterator[tuple[type, dict[str, Any], str]]:
    """Yield (class, keyword arguments, the field that is wrong)."""
    for kind, needed in NEEDS.items():
        for name, allowed in HARD_LIMITS[kind.__name__].items():
            sound = getattr(kind(**needed), name)
            if isinstance(allowed, Range):
                for value in bad_values(allowed):
                    yield kind, needed | {name: value}, name
                continue
            for place, row in enumerate(allowed):
                for value in bad_values(row):
                    wrong = (*sound[:place], value, *sound[place + 1 :])
                    yield kind, needed | {name: wrong}, name
            yield kind, needed | {name: sound[1:]}, name
    yield GuardLimits, {"low": (0.5, 0, 0, 0, 0), "high": (0.4, 0.1, 0.1, 0.1, 0.05)}, "box"
    for gains in BAD_GAINS:
        yield Gains, gains, "gains"
    for name, kind in NESTED.items():
        unchecked = type("Loose", (kind,), {"__post_init__": lambda self: None})
        for value in (None, {}, unchecked(**NEEDS[kind])):
            yield UniforceFrankaConfig, {name: value}, name
    yield UniforceFrankaConfig, {"backend": "ros"}, "backend"
    yield UniforceFrankaConfig, {"realtime": "please"}, "realtime"


def try_all() -> dict[str, Any]:
    """Return how many were tried and refused, and those that were accepted."""
    tried = 0
    accepted = []
    for kind, settings, field in bad_settings():
        tried += 1
        try:
            kind(**settings)
        except ContractError as error:
            if field in str(error):
                continue
            accepted.append(f"{kind.__name__}({settings}): refused without its name: {error}")
        else:
            accepted.append(f"{kind.__name__}({settings})")
    return {"tried": tried, "refused": tried - len(accepted), "accepted": accepted}


def attack(episodes: int, seed: int) -> dict[str, Any]:
    """Return the table's row: settings tried and refused, poses sent, violations."""
    counts = Counter[str]()
    faults = Counter[str]()
    violations: list[str] = []
    for chunk in tqdm(range(0, episodes, CHUNK), desc="episodes"):
        own = seed + chunk // CHUNK
        found = drive(min(CHUNK, episodes - chunk), own)
        counts.update(actions=found["actions"], sent_cases=found["sent"])
        faults.update(found["faults"])
        violations += [f"seed {own}: {what}" for what in found["violations"]]
    return {
        **try_all(),
        **counts,
        "violations": len(violations),
        "examples": violations[:10],
        "faults": dict(faults),
    }


@command(GuardsConfig)
def main(config: GuardsConfig) -> int:
    """Run the attack, write the row, print it; 1 where anything bad went through."""
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
