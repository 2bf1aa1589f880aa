"""Measure the pair recorder's score against the simulator's truth."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from tqdm import tqdm

from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.contact.indenters import PRETRAIN, SEEN
from uniforce_vtla.options import Count, Names, OutFile, Pattern, Seed, split
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.sensors import get_sensor

BAR = 0.95  # wanted precision and recall
# sessions with seeds below were looked at while the score was made; scored ones lie above
SEEN_SEEDS = 2000


ALL_INDENTERS = ",".join(PRETRAIN)
Indenters = Annotated[str, Names(SEEN, many=True)]
Rigs = Annotated[str, Pattern("left+right sensors", r"\w+\+\w+(,\s*\w+\+\w+)*", "gelsight+tactip")]


@dataclass
class PairQualityConfig:
    """Rehearse sessions with known truth and count right and wrong flags; or train the readers.

    Example: python -m benchmarks.pair_quality rigs=gelsight+tactip sessions=1 grasps=2
    Readers of the shipped sensors: python -m benchmarks.pair_quality train=true
    """

    rigs: Rigs = "gelsight+tactip,uskin+tactip,gelsight+uskin"  # left+right, commas between
    sessions: Count = 3  # pairs of units per rig
    grasps: Count = 3  # per indenter and session
    indenters: Indenters = ALL_INDENTERS  # names
    seed: Seed = SEEN_SEEDS  # of the first session; the next ones count up
    train: bool = False  # train the force readers of the rigs' sensors first, into the package
    out: OutFile = "outputs/pair_quality/pair_recorder.json"


def measure(config: PairQualityConfig) -> dict[str, Any]:
    """Return precision and recall over all rehearsed pairs, and by fault, rig, indenter."""
    from benchmarks.pairs.evaluation import ScoredPairs, report, score_session
    from uniforce_robots.pairs import pair_judge
    from uniforce_robots.pairs.rehearsal import Rehearsal

    rigs = []
    for rig in split(config.rigs):
        left, right = rig.split("+")
        rigs.append((get_sensor(left.strip()).name, get_sensor(right.strip()).name))
    if config.train:
        _train(sorted({sensor for rig in rigs for sensor in rig}))
    scored = []
    for number, (left, right) in enumerate(tqdm(config.sessions * rigs, desc="sessions")):
        rehearsal = Rehearsal(left, right, config.seed + number)
        indenters = tuple(split(config.indenters))
        scored.append(score_session(rehearsal, indenters, config.grasps, number))
    settings = {"limit": pair_judge.LIMIT, "trust": pair_judge.TRUST}
    found = report(ScoredPairs.joined(scored))
    return found | {"settings": settings, "config": asdict(config), "bar": BAR}


def _train(sensors: list[str]) -> None:
    from benchmarks.pairs.training import (
        ForceTraining,
        save_finger_force,
        train_finger_force,
        training_contacts,
    )

    training = ForceTraining()
    for sensor in tqdm(sensors, desc="force readers", unit="sensor"):
        model = train_finger_force(*training_contacts(sensor, training), training)
        print(f"reader of {sensor} in {save_finger_force(model, sensor, training)}")


def _line(row: dict[str, Any]) -> str:
    parts = []
    for key in ("precision", "recall"):
        low, high = row[f"{key}_95"]
        parts.append(f"{key} {row[key]:.3f} ({low:.3f}–{high:.3f})")
    return ", ".join(parts)


@command(PairQualityConfig)
def main(config: PairQualityConfig) -> None:
    one_thread()
    content = measure(config)
    path = write_json(Path(config.out), content | provenance())
    for name in ("goal_faults", "all_faults"):
        row = content[name]
        print(f"{name}: {_line(row)}, {row['bad']} of {row['pairs']} pairs out of balance")
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
