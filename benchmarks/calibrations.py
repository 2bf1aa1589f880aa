"""Calibrations of units that no demonstration wears, made once and kept in a folder."""

from pathlib import Path
from typing import Literal

from uniforce_cli.calibrate import (
    CalibrateCommand,
    calibrate_sensor,
    scale_sensor,
    weigh_sensor,
)
from uniforce_cli.record import RecordConfig, record
from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.calibration import Calibration

KNOWN: dict[Finger, str] = {"left": "gelsight", "right": "tactip"}  # worn by demonstrations
UNITS = (2, 3, 4, 5)
GRASPS = 300  # of a label-free calibration
LOADS_N = "3,6,9"  # of a scale, which the sensor presses through the tool

# three recorded wipes of each sensor beside GelSight 1, by a script that reads the true force as a
# person sees the board; no scene of them is scored
WIPES = 3
FIRST_WIPE = 29_100

type Fit = Literal["", "grasps", "tool", "wipes"]


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
    if fit == "tool":
        command = CalibrateCommand(worn, loads_N=LOADS_N, through="tool")
        found = weigh_sensor(command, tokenizer)
    elif fit == "wipes":
        found = _scaled_by_wipes(worn, work / "wipes", tokenizer)
    else:
        found = calibrate_sensor(CalibrateCommand(worn, KNOWN[finger], grasps=GRASPS), tokenizer)
    found.save(folder)
    return folder


def _scaled_by_wipes(worn: str, work: Path, tokenizer: Tokenizer) -> Calibration:
    """Return the gain of a right finger's sensor, which replaces the demonstrations' TacTip."""
    new = _recorded(worn, work)
    before = _recorded(KNOWN["right"], work)
    command = CalibrateCommand(worn, KNOWN["left"], wipes=str(new), replaces=str(before))
    return scale_sensor(command, tokenizer)


def _recorded(worn: str, work: Path) -> Path:
    """Return the dataset in which a right finger's sensor wipes; it is recorded once."""
    root = work / worn.replace(":", "-")
    record(
        RecordConfig(
            episodes=WIPES,
            level="touch",
            left_sensor=KNOWN["left"],
            right_sensor=worn,
            gripper="hand",
            seed=FIRST_WIPE,
            root=str(root),
        )
    )
    return root
