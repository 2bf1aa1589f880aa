"""Calibrations of units that no demonstration wears, made once and kept in a folder."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from uniforce_cli.calibrate import CalibrateCommand, calibrate_sensor, weigh_sensor
from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer

KNOWN: dict[Finger, str] = {"left": "gelsight", "right": "tactip"}  # worn by demonstrations
UNITS = (2, 3, 4, 5)
GRASPS = 300  # of a label-free calibration
LOADS_N = "3,6,9"  # of a scale, which the sensor presses through the tool

# by grasps | weighed on a scale, through the tool
type Fit = Literal["", "grasps", "tool"]


def units(kind: str) -> tuple[str, ...]:
    """Return the units of a kind that are calibrated, in words."""
    return tuple(f"{kind}:{unit}" for unit in UNITS)


def calibration_folder(worn: str, fit: Fit, work: Path, finger: Finger = "right") -> Path:
    """Return the folder of a unit's calibration; it is made where there is none.

    Grasps are felt beside the sensor that the finger wore in the demonstrations.
    """
    made = f"calibrations_{fit}"
    if finger == "left":
        made += "_left"
    folder = work / made / worn.replace(":", "-")
    if folder.is_dir():
        return folder
    tokenizer = Tokenizer.from_pretrained()
    command = CalibrateCommand(worn, KNOWN[finger], grasps=GRASPS)
    if fit == "tool":
        command = replace(command, loads_N=LOADS_N, through="tool")
        found = weigh_sensor(command, tokenizer)
    else:
        found = calibrate_sensor(command, tokenizer)
    found.save(folder)
    return folder
