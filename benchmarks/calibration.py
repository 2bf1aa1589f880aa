"""Force error on sensors of other stiffness and gain before and after label-free calibration."""

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.probes.report_sets import get_report_set
from benchmarks.probes.zero_shot import POOL, Table, encode_set, predict, score, sized_head
from benchmarks.tokenizer_report import draw_sets
from uniforce_cli.boundary import command
from uniforce_cli.calibrate import CalibrateCommand, calibrate_sensor
from uniforce_vtla.options import FolderPath, OutFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.head_training import train_head

RESULT = "heldout_hidden.json"


@dataclass
class CalibrationReport(CalibrateCommand):
    """Calibrate every sensor of heldout_hidden_v1 with every anchor; ``new``, ``anchor`` and ``out`` are not used.

    Example: python -m benchmarks.calibration results=outputs/calibration
    """

    results: OutFolder = "outputs/calibration"  # where the report goes
    facts: FolderPath = "docs/results"  # the frozen sets' recipes and hashes
    cache: OutFolder = "outputs/labelled"  # drawn sets


def measure(config: CalibrationReport, tokenizer: Tokenizer) -> dict[str, Any]:
    """Return force R² and MAE on ``heldout_hidden_v1`` before and after, heads trained on each anchor."""
    report_set = get_report_set("heldout_hidden_v1")
    facts = json.loads((Path(config.facts) / report_set.facts_file).read_text())
    table = draw_sets(report_set, tokenizer.config.side, Path(config.cache))
    cells = {}
    for anchor, new in tqdm(table.transfers(), desc="calibrations"):
        cells[f"{anchor}->{new}"] = _measure_one(config, tokenizer, table, anchor, new)
    r2 = {when: np.array([c[when]["r2"] for c in cells.values()]) for when in ("before", "after")}
    return {
        "what": "simulated; heads trained on the anchor, scored on held-out sensors of other stiffness and gain",
        "set": facts["set"],
        "set_hash": facts["set_hash"],
        "tokenizer_hash": tokenizer.hash,
        "mean_r2": {when: values.mean(axis=0).tolist() for when, values in r2.items()},
        "worst_r2": {when: values.min(axis=0).tolist() for when, values in r2.items()},
        "cells": cells,
    } | provenance()


def _measure_one(
    config: CalibrationReport, tokenizer: Tokenizer, table: Table, anchor: str, new: str
) -> dict[str, Any]:
    z = encode_set(tokenizer, table.training[anchor])
    head = train_head(z, table.training[anchor].force_N, sized_head(table.head, z, POOL), seed=0)
    calibration = calibrate_sensor(config, tokenizer, new, anchor)
    target = encode_set(tokenizer, table.frozen[new])  # (n, T, 16, L)
    adapted = calibration(target.flatten(0, 1)).unflatten(0, target.shape[:2])
    truth = table.forces(new)
    return {
        "before": score(truth, predict(head, target)),
        "after": score(truth, predict(head, adapted)),
        "calibration": calibration.facts() | {"config": asdict(config.fit)},
    }


@command(CalibrationReport)
def main(config: CalibrationReport) -> None:
    """Entry of ``python -m benchmarks.calibration``."""
    torch.set_num_threads(1)
    content = measure(config, Tokenizer.from_pretrained(config.tokenizer or None))
    path = write_json(Path(config.results) / RESULT, content)
    for when, values in content["mean_r2"].items():
        print(f"{when}: R² Fx, Fy, Fz {np.round(values, 2)}")
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
