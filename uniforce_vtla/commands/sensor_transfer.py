"""Fit what other sensors would have said of the same touch, for policies that shall be worn with another sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from uniforce_vtla.commands.arguments import parse
from uniforce_vtla.contact.pairs import PairSettings
from uniforce_vtla.contact.same_touch import same_touches
from uniforce_vtla.contact.sampling import ForceRange
from uniforce_vtla.errors import UniForceError
from uniforce_vtla.sensors import get_sensor, list_sensors
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.pair_cache import shrink
from uniforce_vtla.tokenizer.pooling import pool_latent
from uniforce_vtla.tokenizer.transfer import FOLDER, TransferConfig, fit_transfer
from uniforce_vtla.tokenizer.weights import checkpoint_folder


@dataclass
class SensorTransferCommand:
    """Draw the same touches for every sensor, encode them, and fit maps from each sensor's latents to each other's.

    ``policy.sensor_transfer`` trains with them. No force label is used and no demo is looked at.

    Example: uniforce-sensor-transfer tokenizer=outputs/small/tokenizer
    """

    tokenizer: str = "small"  # shipped size, or a checkpoint folder; the maps go beside or into it
    sensors: str = ""  # registry names, commas between; empty = all
    fit: TransferConfig = field(default_factory=TransferConfig)  # touches drawn, and how maps are fitted


def draw_latents(
    tokenizer: Tokenizer, kinds: list[str], config: TransferConfig
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return sensor → pooled latents (N, grid², L) of the same N touches, of two units of it."""
    force_range = ForceRange(flat_torsion_arm_mm=config.flat_torsion_arm_mm)
    settings = PairSettings(flat_share=config.flat_share, force_range=force_range)
    blocks = -(-config.contacts // settings.pairs_per_unit)
    rng, side = np.random.default_rng([config.seed, 77]), tokenizer.config.side
    drawn = same_touches(rng, blocks, [*kinds, *kinds], settings, lambda images: shrink(images, side))
    encoded = [
        [pool_latent(tokenizer.encode(*views), config.grid).numpy() for views in block]
        for block in tqdm(drawn, total=blocks, desc="touches", unit=f"×{settings.pairs_per_unit}")
    ]
    units = [np.concatenate(parts) for parts in zip(*encoded, strict=True)]
    return {kind: (units[k], units[k + len(kinds)]) for k, kind in enumerate(kinds)}


def _run(command: SensorTransferCommand) -> str:
    tokenizer = Tokenizer.from_pretrained(command.tokenizer)
    kinds = [get_sensor(name.strip()).name for name in command.sensors.split(",") if name.strip()]
    latents = draw_latents(tokenizer, kinds or list(list_sensors()), command.fit)
    transfer, facts = fit_transfer(latents, tokenizer.hash, command.fit)
    folder = checkpoint_folder(command.tokenizer, FOLDER)
    path = transfer.save(folder if folder.name == FOLDER else folder / FOLDER, facts)
    lines = [
        f"{pair}: differ by {told['rms']:.2f} spreads, by {told['rms_left']:.2f} once mapped"
        for pair, told in facts["differences"].items()
    ]
    return "\n".join([*lines, f"maps in {Path(path)}"])


def main(argv: list[str] | None = None) -> int:
    """Entry of ``uniforce-sensor-transfer``."""
    command = parse(SensorTransferCommand, argv)
    torch.set_num_threads(1)
    try:
        print(_run(command))
    except UniForceError as error:
        print(f"sensor_transfer: {error}")
        return 2
    return 0
