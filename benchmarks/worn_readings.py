"""What is read from sensors of odd stiffness or gain in the scene, calibrated and not; the true wrench drives."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.stress.readings import read_scenes
from uniforce_cli.boundary import Level, command
from uniforce_cli.calibrate import CalibrateCommand, calibrate_sensor
from uniforce_vtla.options import Count, OutFile, Seed, TokenizerFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

WORN = ("gelsight_stiff", "uskin_keen", "tactip_soft")
ANCHOR = "tactip"


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
        seeds = range(config.first_seed, config.first_seed + config.scenes)
        read = read_scenes(config.level, "left", f"{name}:drawing", seeds, tokenizer)
        latent, truth = read.latent, read.truth_N
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
