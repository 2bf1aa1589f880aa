"""Readings of sensors of odd stiffness or gain in the scene, calibrated and not; the true wrench drives."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.stress.readings import Readings, read_scenes
from uniforce_cli.boundary import Level, command
from uniforce_cli.calibrate import CalibrateCommand, calibrate_sensor
from uniforce_vtla.options import Count, OutFile, Seed, TokenizerFolder
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

WORN = ("gelsight_stiff", "uskin_keen", "tactip_soft")
ANCHOR = "tactip"
PRESSED_N = 3.0  # the eraser is on the board


@dataclass
class WornReadingsCommand:
    """Let the expert wipe with each odd sensor on the left finger and compare what is read with the truth.

    Example: python -m benchmarks.worn_readings scenes=10 out=outputs/worn_readings.json
    """

    scenes: Count = 10  # per sensor
    first_seed: Seed = 39_500  # development scenes
    level: Level = "touch"
    grasps: Count = 600  # pairs of each calibration
    tokenizer: TokenizerFolder = ""  # checkpoint folder; empty = shipped
    out: OutFile = "outputs/worn_readings.json"


def compare(read_N: np.ndarray, found: Readings) -> dict[str, float]:
    """Return how press (shear along y) and grip (normal force) are read.

    A worn sensor shows the force of a step earlier: the noise of the press is what stays of it beside that force.
    """
    true_N, on_board = found.truth_N, found.press_N > PRESSED_N
    slope, offset = np.polyfit(true_N[:, 1], read_N[:, 1], 1)
    before, read = found.before_N[on_board, 1], read_N[on_board, 1]
    return {
        "readings": len(true_N),
        "press_slope": float(slope),
        "press_offset_N": float(offset),
        "press_r": float(np.corrcoef(true_N[:, 1], read_N[:, 1])[0, 1]),
        "press_noise_N": float((read - np.polyval(np.polyfit(before, read, 1), before)).std()),
        "grip_bias_N": float((read_N[:, 2] - true_N[:, 2]).mean()),
        "grip_mae_N": float(np.abs(read_N[:, 2] - true_N[:, 2]).mean()),
    }


def measure(config: WornReadingsCommand) -> dict[str, Any]:
    """Return the comparison per sensor, nothing fitted and calibrated; the nominal sensors beside them."""
    tokenizer = Tokenizer.from_pretrained(config.tokenizer or None)
    head = ForceHead.from_pretrained(ANCHOR, config.tokenizer or None)
    sensors: dict[str, Any] = {}
    for name in (*WORN, "gelsight", "uskin", "tactip"):
        new, anchor = f"{name}:drawing", f"{ANCHOR}:drawing"
        seeds = range(config.first_seed, config.first_seed + config.scenes)
        found = read_scenes(config.level, "left", new, seeds, tokenizer)
        rows: dict[str, dict[str, Any]] = {"before": compare(head(found.latent).numpy(), found)}
        settings = CalibrateCommand(new, anchor, grasps=config.grasps, tokenizer=config.tokenizer)
        calibration = calibrate_sensor(settings, tokenizer)
        read = compare(head(calibration(found.latent)).numpy(), found)
        rows["calibrated"] = read | {"calibration": calibration.facts()}
        sensors[name] = rows
    return {
        "level": config.level,
        "anchor": ANCHOR,
        "tokenizer_hash": tokenizer.hash,
        "sensors": sensors,
    }


@command(WornReadingsCommand)
def main(config: WornReadingsCommand) -> None:
    torch.set_num_threads(1)
    content = measure(config)
    print(f"{'sensor':16} {'':10} press × and + N, r | grip bias, error N")
    for name, rows in content["sensors"].items():
        for when, row in rows.items():
            press = f"{row['press_slope']:.2f} {row['press_offset_N']:+.2f} {row['press_r']:.2f}"
            grip = f"{row['grip_bias_N']:+.2f} {row['grip_mae_N']:.2f}"
            print(f"{name:16} {when:10} {press}, noise {row['press_noise_N']:.2f} N | {grip}")
    print(f"written to {write_json(Path(config.out), content | provenance())}")


if __name__ == "__main__":
    sys.exit(main())
