"""How a sensor that was in no training fares: read by the others' heads, the others read by its own, and how fast."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.probes.labelled_set import FROZEN, HEAD_TRAINING, SENSORS, draw_labelled
from benchmarks.probes.zero_shot import (
    POOL,
    Table,
    encode_set,
    learnt_row,
    shipped_cell,
    transfer_name,
)
from benchmarks.speed.canonicalizer import canonicalizer_rate
from uniforce_cli.boundary import Sensor, command, one_thread
from uniforce_vtla.options import Count, OutFile
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer


@dataclass
class NewSensorConfig:
    """Score a registered sensor against the three that pretraining and the shipped heads are for.

    Example: python -m benchmarks.new_sensor sensor=paxini out=outputs/new_sensor.json
    """

    sensor: Sensor = "paxini"
    sequences: Count = 40  # scored, of 12 frames each, unseen indenters
    lessons: Count = 150  # sequences that its own head learns from, seen indenters
    seeds: Count = 1  # own heads
    rate_s: Count = 2  # seconds for which the canonicalizer is timed
    out: OutFile = "outputs/new_sensor.json"


def new_sensor(config: NewSensorConfig) -> dict[str, Any]:
    """Return scores by transfer, of the shipped heads and of the sensor's own, and the canonicalizer's rate in Hz."""
    tokenizer, name = Tokenizer.from_pretrained(), config.sensor
    scored = replace(FROZEN, name=f"new_{name}", seed=52_002, sequences=config.sequences)
    lessons = replace(HEAD_TRAINING, name=f"lessons_{name}", seed=52_003, sequences=config.lessons)
    side = tokenizer.config.side
    frozen = {sensor: draw_labelled(scored, sensor, side) for sensor in (name, *SENSORS)}
    rows = {
        transfer_name(source, name): shipped_cell(
            ForceHead.from_pretrained(source), tokenizer, frozen[name]
        )
        for source in SENSORS
    }
    own = Table({name: draw_labelled(lessons, name, side)}, frozen)
    rows |= learnt_row(own, lambda labelled: encode_set(tokenizer, labelled), config.seeds, POOL)
    cv2.setNumThreads(1)
    return {
        "what": "simulated; shipped heads read the sensor, its own head reads the others; unseen indenters",
        "frames": config.sequences * scored.length,
        "own_heads": config.seeds,
        "canonicalize_hz": canonicalizer_rate(name, np.random.default_rng(0), config.rate_s),
        "rows": rows,
        "tokenizer_hash": tokenizer.hash,
    }


@command(NewSensorConfig)
def main(config: NewSensorConfig) -> None:
    one_thread()
    found = new_sensor(config)
    for transfer, cell in found["rows"].items():
        print(f"{transfer:16s} R² " + " ".join(f"{value:6.2f}" for value in cell["r2"]))
    print(
        f"canonicalizer {found['canonicalize_hz']:.0f} Hz; {write_json(Path(config.out), found | provenance())}"
    )


if __name__ == "__main__":
    sys.exit(main())
