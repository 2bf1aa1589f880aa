"""Calibrate a new sensor without force labels, by grasping an externally held object with a known one."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from tqdm import tqdm

from uniforce_commands.boundary import command
from uniforce_commands.tokenizer_report import draw_sets
from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.pairs import PairSettings, equilibrium_pairs
from uniforce_vtla.contact.units import Look
from uniforce_vtla.contact.virtual import GELSIGHT_D, VirtualSensor, as_virtual
from uniforce_vtla.options import Count, FolderPath, Names, OutFolder, Seed, TokenizerFolder
from uniforce_vtla.probes.hard_sets import hidden_sensors
from uniforce_vtla.probes.report_sets import get_report_set
from uniforce_vtla.probes.zero_shot import POOL, Table, encode_set, predict, score, sized_head
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration, CalibrationConfig, calibrate, calibration_facts
from uniforce_vtla.tokenizer.head_training import train_head
from uniforce_vtla.tokenizer.pair_cache import shrink
from uniforce_vtla.tokenizer.pooling import pool_latent

RESULT = "heldout_hidden.json"


VirtualSensorName = Annotated[str, Names((*hidden_sensors(), GELSIGHT_D.name, *list_sensors()))]


@dataclass
class CalibrateCommand:
    """Fit an adapter for the sensor ``new`` to paired grasps with the sensor ``anchor``; no force is measured.

    Grasps are simulated in this release: a minute with an object held from outside, 10 Hz, every force.

    Example: uniforce-calibrate new=gelsight_stiff anchor=tactip out=outputs/calibration
    """

    # gelsight_stiff | tactip_soft | uskin_keen, or a registry sensor
    new: VirtualSensorName = "gelsight_stiff"
    anchor: VirtualSensorName = "tactip"  # gelsight | gelsight_d | tactip | uskin: the sensor that is known
    grasps: Count = 600  # pairs: one minute at 10 Hz
    units: Count = 8  # units of the new sensor that take turns; 1 = your own sensor
    out: OutFolder = "outputs/calibration"  # the adapter's folder
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    report: bool = False  # calibrate all of heldout_hidden_v1 with every anchor; force error before and after
    results: OutFolder = "outputs/calibration"  # where the report goes
    facts: FolderPath = "docs/results"  # of the report: the frozen sets' recipes and hashes
    cache: OutFolder = "outputs/labelled"  # drawn sets
    fit: CalibrationConfig = field(default_factory=CalibrationConfig)  # the adapter's size and steps
    seed: Seed = 0  # of the grasps


def find_sensor(name: str) -> VirtualSensor:
    """Return a held-out or registry sensor by name; SensorError for others."""
    return hidden_sensors().get(name) or as_virtual(name)


def grasp_latents(
    command: CalibrateCommand, tokenizer: Tokenizer, new: VirtualSensor, anchor: VirtualSensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return pooled (n, POOL², latent) of both fingers for the same simulated grasps, new left, anchor right."""
    per_unit = max(1, command.grasps // command.units)
    settings = PairSettings(pairs_per_unit=per_unit, look=Look())
    side = tokenizer.config.side
    pairs = equilibrium_pairs(
        np.random.default_rng([command.seed, 55]),
        per_unit * command.units,
        new,
        anchor,
        PRETRAIN,
        settings=settings,
        transform=lambda images: shrink(images, side),
    )
    left = tokenizer.encode(pairs.left_reference, pairs.left_current, "left")
    right = tokenizer.encode(pairs.right_reference, pairs.right_current, "right")
    return pool_latent(left, POOL), pool_latent(right, POOL)  # what heads and policies read


def calibrate_sensor(command: CalibrateCommand, tokenizer: Tokenizer, new: str, anchor: str) -> Calibration:
    """Grasp and fit."""
    latents = grasp_latents(command, tokenizer, find_sensor(new), find_sensor(anchor))
    return calibrate(*latents, tokenizer.hash, new, anchor, command.fit)


def measure(command: CalibrateCommand, tokenizer: Tokenizer) -> dict[str, Any]:
    """Return force R² and MAE on ``heldout_hidden_v1`` before and after, heads trained on each anchor."""
    report_set = get_report_set("heldout_hidden_v1")
    facts = json.loads((Path(command.facts) / report_set.facts_file).read_text())
    table = draw_sets(report_set, tokenizer.config.side, Path(command.cache))
    cells = {}
    for anchor, new in tqdm(table.transfers(), desc="calibrations"):
        cells[f"{anchor}->{new}"] = _measure_one(command, tokenizer, table, anchor, new)
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
    command: CalibrateCommand, tokenizer: Tokenizer, table: Table, anchor: str, new: str
) -> dict[str, Any]:
    z = encode_set(tokenizer, table.training[anchor])
    head = train_head(z, table.training[anchor].force_N, sized_head(table.head, z, POOL), seed=0)
    calibration = calibrate_sensor(command, tokenizer, new, anchor)
    target = encode_set(tokenizer, table.frozen[new])  # (n, T, 16, L)
    adapted = calibration(target.flatten(0, 1)).unflatten(0, target.shape[:2])
    truth = table.forces(new)
    return {
        "before": score(truth, predict(head, target)),
        "after": score(truth, predict(head, adapted)),
        "calibration": calibration_facts(calibration, command.fit),
    }


def _run(command: CalibrateCommand) -> str:
    tokenizer = Tokenizer.from_pretrained(command.tokenizer or None)
    if command.report:
        content = measure(command, tokenizer)
        path = write_json(Path(command.results) / RESULT, content)
        lines = [f"{when}: R² Fx, Fy, Fz {np.round(v, 2)}" for when, v in content["mean_r2"].items()]
        return "\n".join([*lines, f"written to {path}"])
    calibration = calibrate_sensor(command, tokenizer, command.new, command.anchor)
    path = calibration.save(command.out)
    change = f"{calibration.imbalance_before:.3f} → {calibration.imbalance_after:.3f}"
    return f"{command.new} against {command.anchor}: imbalance on held-out grasps {change}; adapter in {path}"


@command(CalibrateCommand)
def main(command: CalibrateCommand) -> int:
    """Entry of ``uniforce-calibrate``."""
    torch.set_num_threads(1)
    print(_run(command))
    return 0
