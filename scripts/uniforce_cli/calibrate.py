"""Calibrate a new sensor without force labels, by grasping an externally held object with a known one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.options import Count, Names, OutFolder, Seed, TokenizerFolder
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.settings import CalibrationConfig

if TYPE_CHECKING:
    from uniforce_vtla.tokenizer.api import Tokenizer
    from uniforce_vtla.tokenizer.calibration import Calibration

# of contact.virtual, slow to import; tested
VIRTUAL = ("gelsight_stiff", "tactip_soft", "uskin_keen", "gelsight_d")
VirtualSensorName = Annotated[str, Names((*VIRTUAL, *list_sensors()))]


@dataclass
class CalibrateCommand:
    """Fit an adapter for the sensor ``new`` to paired grasps with the sensor ``anchor``; no force is measured.

    Grasps are simulated in this release: a minute with an object held from outside, 10 Hz, every force.

    Example: uniforce calibrate new=gelsight_stiff anchor=tactip out=outputs/calibration
    """

    new: VirtualSensorName = "gelsight_stiff"  # the sensor to fit
    anchor: VirtualSensorName = "tactip"  # the sensor that is known
    grasps: Count = 600  # pairs: one minute at 10 Hz
    units: Count = 8  # units of the new sensor that take turns; 1 = your own sensor
    out: OutFolder = "outputs/calibration"  # the adapter's folder
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    fit: CalibrationConfig = field(default_factory=CalibrationConfig)  # the adapter's size and steps
    seed: Seed = 0  # of the grasps


def calibrate_sensor(command: CalibrateCommand, tokenizer: Tokenizer, new: str, anchor: str) -> Calibration:
    """Grasp in simulation, the new sensor left and the anchor right, and fit; SensorError for unknown sensors."""
    import numpy as np

    from uniforce_vtla.contact.indenters import PRETRAIN
    from uniforce_vtla.contact.pairs import PairSettings, equilibrium_pairs
    from uniforce_vtla.contact.units import Look
    from uniforce_vtla.contact.virtual import as_virtual, hidden_sensors
    from uniforce_vtla.tokenizer.calibration import calibrate
    from uniforce_vtla.tokenizer.latent import POOL, pool_latent
    from uniforce_vtla.tokenizer.pair_cache import shrink

    per_unit, side = max(1, command.grasps // command.units), tokenizer.config.side
    left_sensor, right_sensor = (hidden_sensors().get(name) or as_virtual(name) for name in (new, anchor))
    pairs = equilibrium_pairs(
        np.random.default_rng([command.seed, 55]),
        per_unit * command.units,
        left_sensor,
        right_sensor,
        PRETRAIN,
        settings=PairSettings(pairs_per_unit=per_unit, look=Look()),
        transform=lambda images: shrink(images, side),
    )
    left = tokenizer.encode(pairs.left_reference, pairs.left_current, "left")
    right = tokenizer.encode(pairs.right_reference, pairs.right_current, "right")
    latents = pool_latent(left, POOL), pool_latent(right, POOL)  # (n, POOL², L): what heads and policies read
    return calibrate(*latents, tokenizer.hash, new, anchor, command.fit)


@command(CalibrateCommand)
def main(command: CalibrateCommand) -> None:
    from uniforce_vtla.tokenizer.api import Tokenizer

    one_thread()
    tokenizer = Tokenizer.from_pretrained(command.tokenizer or None)
    found = calibrate_sensor(command, tokenizer, command.new, command.anchor)
    change = f"imbalance on held-out grasps {found.imbalance_before:.3f} → {found.imbalance_after:.3f}"
    print(f"{command.new} against {command.anchor}: {change}; adapter in {found.save(command.out)}")
