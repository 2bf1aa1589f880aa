"""Calibrate a new sensor without force labels, by grasping an externally held object with a known one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import torch

from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.pairs import PairSettings, equilibrium_pairs
from uniforce_vtla.contact.units import Look
from uniforce_vtla.contact.virtual import GELSIGHT_D, VirtualSensor, as_virtual, hidden_sensors
from uniforce_vtla.options import Count, Names, OutFolder, Seed, TokenizerFolder
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration, CalibrationConfig, calibrate
from uniforce_vtla.tokenizer.pair_cache import shrink
from uniforce_vtla.tokenizer.pooling import POOL, pool_latent

VirtualSensorName = Annotated[str, Names((*hidden_sensors(), GELSIGHT_D.name, *list_sensors()))]


@dataclass
class CalibrateCommand:
    """Fit an adapter for the sensor ``new`` to paired grasps with the sensor ``anchor``; no force is measured.

    Grasps are simulated in this release: a minute with an object held from outside, 10 Hz, every force.

    Example: uniforce calibrate new=gelsight_stiff anchor=tactip out=outputs/calibration
    """

    # gelsight_stiff | tactip_soft | uskin_keen, or a registry sensor
    new: VirtualSensorName = "gelsight_stiff"
    anchor: VirtualSensorName = "tactip"  # gelsight | gelsight_d | tactip | uskin: the sensor that is known
    grasps: Count = 600  # pairs: one minute at 10 Hz
    units: Count = 8  # units of the new sensor that take turns; 1 = your own sensor
    out: OutFolder = "outputs/calibration"  # the adapter's folder
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
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


@command(CalibrateCommand)
def main(command: CalibrateCommand) -> int:
    """Entry of ``uniforce calibrate``."""
    one_thread()
    tokenizer = Tokenizer.from_pretrained(command.tokenizer or None)
    found = calibrate_sensor(command, tokenizer, command.new, command.anchor)
    change = f"imbalance on held-out grasps {found.imbalance_before:.3f} → {found.imbalance_after:.3f}"
    print(f"{command.new} against {command.anchor}: {change}; adapter in {found.save(command.out)}")
    return 0
