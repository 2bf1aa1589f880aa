"""What is read from sensors that answer unlike the known ones, worn in the wiping scene, calibrated and not.

The expert drives by the true wrench, so no policy is needed. On development scenes; the sensors' stiffness and gain
were part of no pretraining.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_cli.boundary import Level, command
from uniforce_cli.calibrate import CalibrateCommand, calibrate_sensor
from uniforce_vtla.contact.virtual import any_virtual
from uniforce_vtla.contact.worn import drawing
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.options import Count, OutFile, Seed, TokenizerFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead
from uniforce_vtla.tokenizer.latent import POOL, Latent, pool_latent

WORN = ("gelsight_stiff", "uskin_keen", "tactip_soft")
ANCHOR = "tactip"
EVERY = 10  # steps between two readings
GRIPPED_N = 1.0  # the object is held


@dataclass
class WornReadingsCommand:
    """Let the expert wipe with each odd sensor on the left finger and compare what is read with the truth.

    Example: python -m benchmarks.worn_readings scenes=10 out=outputs/worn_readings.json
    """

    scenes: Count = 10  # per sensor
    first_seed: Seed = 39_500  # development scenes
    level: Level = "touch"
    grasps: Count = 200  # pairs of the calibration
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    out: OutFile = "outputs/worn_readings.json"


def readings(config: WornReadingsCommand, tokenizer: Tokenizer, name: str) -> tuple[Latent, np.ndarray]:
    """Return pooled latents (n, P, L) of the left finger over all scenes, and the true force (n, 3), canonical."""
    env, latents, truth = WipeEnv(config.level, drawing(any_virtual(name))), [], []
    for seed in tqdm(range(config.first_seed, config.first_seed + config.scenes), desc=name, leave=False):
        for step, _ in enumerate(walk(env, WipeExpert(), seed)):
            force = env.true_wrench()["left"][:3]
            if step % EVERY or force[2] < GRIPPED_N:
                continue
            pixels = env.observe()["pixels"]
            pair = [pixels[tactile_name("left", reference)][None, ..., 0] for reference in (True, False)]
            latents.append(pool_latent(tokenizer.encode(*pair, "left"), POOL))
            truth.append(force)
    return Latent.of(torch.cat(latents).as_subclass(torch.Tensor), tokenizer.hash), np.stack(truth)


def compare(read_N: np.ndarray, true_N: np.ndarray) -> dict[str, float]:
    """Return how press (shear along y) and grip (normal force) are read."""
    slope, offset = np.polyfit(true_N[:, 1], read_N[:, 1], 1)
    return {
        "readings": len(true_N),
        "press_slope": float(slope),
        "press_offset_N": float(offset),
        "press_r": float(np.corrcoef(true_N[:, 1], read_N[:, 1])[0, 1]),
        "grip_bias_N": float((read_N[:, 2] - true_N[:, 2]).mean()),
        "grip_mae_N": float(np.abs(read_N[:, 2] - true_N[:, 2]).mean()),
    }


def measure(config: WornReadingsCommand) -> dict[str, Any]:
    """Return the comparison per sensor, nothing fitted and calibrated; the nominal sensors beside them."""
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    head = ForceHead.from_pretrained(ANCHOR, config.tokenizer or None)
    found: dict[str, Any] = {}
    for name in (*WORN, "gelsight", "uskin", "tactip"):
        latent, truth = readings(config, tokenizer, name)
        settings = CalibrateCommand(
            f"{name}:drawing", f"{ANCHOR}:drawing", grasps=config.grasps, tokenizer=config.tokenizer
        )
        calibration = calibrate_sensor(settings, tokenizer)
        found[name] = {
            "before": compare(head(latent).numpy(), truth),
            "calibrated": compare(head(calibration(latent)).numpy(), truth),
            "calibration": calibration.facts(),
        }
    return {"level": config.level, "anchor": ANCHOR, "tokenizer_hash": tokenizer.hash, "sensors": found}


@command(WornReadingsCommand)
def main(config: WornReadingsCommand) -> None:
    """Entry of ``python -m benchmarks.worn_readings``."""
    torch.set_num_threads(1)
    content = measure(config)
    print(f"{'sensor':16} {'':10} press × and + N, r | grip bias, error N")
    for name, rows in content["sensors"].items():
        for when in ("before", "calibrated"):
            row = rows[when]
            press = f"{row['press_slope']:.2f} {row['press_offset_N']:+.2f} {row['press_r']:.2f}"
            print(f"{name:16} {when:10} {press} | {row['grip_bias_N']:+.2f} {row['grip_mae_N']:.2f}")
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
