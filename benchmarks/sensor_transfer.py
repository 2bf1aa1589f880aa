"""Fit what the other finger's latent would be, whatever sensor it wears, for policies that shall swap sensors."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from benchmarks.transfer_fit import GraspLatents, SensorTransferFit, fit_transfer, two_fingers
from uniforce_cli.boundary import Sensors, command
from uniforce_vtla.contact.pairs import PairSettings
from uniforce_vtla.contact.sampling import ForceRange
from uniforce_vtla.options import TokenizerFolder, split
from uniforce_vtla.sensors import get_sensor, list_sensors
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.latent import pool_latent
from uniforce_vtla.tokenizer.pair_cache import shrink
from uniforce_vtla.tokenizer.sensor_transfer import FOLDER
from uniforce_vtla.tokenizer.weights import checkpoint_folder


@dataclass
class SensorTransferCommand:
    """Draw grasps for every sensor on either finger and fit maps from one finger's latents to the other's.

    ``policy.augment.sensor_transfer`` trains with them. No force label is used and no demo is looked at.

    Example: python -m benchmarks.sensor_transfer tokenizer=outputs/small/tokenizer
    """

    # shipped size, or a checkpoint folder; the maps go beside or into it
    tokenizer: TokenizerFolder = "small"
    sensors: Sensors = ""  # registry names, commas between; empty = all
    fit: SensorTransferFit = field(default_factory=SensorTransferFit)  # grasps drawn, and how maps are fitted


def draw_latents(tokenizer: Tokenizer, kinds: list[str], config: SensorTransferFit) -> dict[str, GraspLatents]:
    """Return sensor → its latents of the same grasps on either finger."""
    force_range = ForceRange(flat_torsion_arm_mm=config.flat_torsion_arm_mm)
    settings = PairSettings(
        flat_share=config.flat_share,
        flat_side_mm=config.flat_side_mm,
        flat_tilt_rad=config.flat_tilt_rad,
        force_range=force_range,
    )
    blocks = -(-config.grasps // settings.pairs_per_unit)
    rng, side = np.random.default_rng([config.seed, 77]), tokenizer.config.side

    def pooled(reference: np.ndarray, current: np.ndarray) -> np.ndarray:
        return pool_latent(tokenizer.encode(reference, current), config.grid).numpy()

    drawn = two_fingers(rng, blocks, kinds, settings, config.other, lambda images: shrink(images, side))
    latents: dict[str, list[tuple[np.ndarray, ...]]] = {kind: [] for kind in kinds}
    for first, second in tqdm(drawn, total=blocks, desc="grasps", unit=f"×{settings.pairs_per_unit}"):
        for kind, (reference, current), views in zip(kinds, first, second, strict=True):
            latents[kind].append((pooled(reference, current), pooled(*views), pooled(reference, reference[None])))
    joined = {kind: [np.concatenate(part) for part in zip(*rows, strict=True)] for kind, rows in latents.items()}
    return {kind: GraspLatents(one, two, rest.mean(axis=0)) for kind, (one, two, rest) in joined.items()}


def _run(command: SensorTransferCommand) -> str:
    tokenizer = Tokenizer.from_pretrained(command.tokenizer)
    kinds = [get_sensor(name).name for name in split(command.sensors)]
    latents = draw_latents(tokenizer, kinds or list(list_sensors()), command.fit)
    transfer, facts = fit_transfer(latents, tokenizer.hash, command.fit)
    folder = checkpoint_folder(command.tokenizer, FOLDER)
    path = transfer.save(folder if folder.name == FOLDER else folder / FOLDER, facts)
    lines = [
        f"{pair}: differ by {found['rms']:.2f} spreads, by {found['rms_left']:.2f} once mapped"
        for pair, found in facts["differences"].items()
    ]
    return "\n".join([*lines, f"maps in {Path(path)}"])


@command(SensorTransferCommand)
def main(command: SensorTransferCommand) -> None:
    """Entry of ``python -m benchmarks.sensor_transfer``."""
    torch.set_num_threads(1)
    print(_run(command))


if __name__ == "__main__":
    sys.exit(main())
