"""Grasps of two real uSkins on a Franka hand: seven trials, none with newtons.

The object falls in two trials; their last scans are free air. The other five are in contact from
the first scan to the last and borrow that reference: the sensors stayed on the hand.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.real.grasps import BORROWED, FEWEST_FRAMES, Grasp, drawn_grasp
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.markers.reference import capture_taxel_reference

SENSOR = "uskin"
DROPPED = ("data_sample_2022-02-22-08-10-01", "data_sample_2022-02-22-15-15-00")
LENDER = DROPPED[1]
LOGS: dict[Finger, str] = {"left": "xela_sensor1.csv", "right": "xela_sensor2.csv"}
FREE_SCANS = 10  # the last ones, after the object has fallen
STEP = 6  # scans between two that are read, a tenth of a second
PRESSED_counts = 300  # of a taxel's z; free air scatters by some 20


def read_scans(path: Path) -> np.ndarray:
    """Return (T, 16, 3) raw counts of one finger's log.

    Raises DatasetError: no such file, or no rows of 48 numbers.
    """
    try:
        rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
        return rows.round().astype(np.int64).reshape(-1, 16, 3)
    except (OSError, ValueError) as error:
        do = "Give data_set of imanlab/proactive-slip-control."
        raise DatasetError(expected(path.name, "rows of 48 counts", error, do)) from error


def find_uskin_grasps(folder: str | Path) -> Iterator[Grasp]:
    """Yield the trials with enough contact; each counts as an object of its own.

    Raises DatasetError: a folder without the trial that shows free air, or a damaged log.
    """
    root = Path(folder)
    lent = {finger: _free_air(root / LENDER / log) for finger, log in LOGS.items()}
    for trial in sorted(path for path in root.iterdir() if path.is_dir()):
        scans = {finger: read_scans(trial / log) for finger, log in LOGS.items()}
        group = f"{SENSOR}{BORROWED}"
        references = lent
        if trial.name in DROPPED:
            group = SENSOR
            references = {finger: _free_air(trial / log) for finger, log in LOGS.items()}
        count = min(len(of_finger) for of_finger in scans.values())
        numbers = []
        for number in range(0, count, STEP):
            if all(_presses(scans[finger][number], references[finger]) for finger in FINGERS):
                numbers.append(number)
        if len(numbers) >= FEWEST_FRAMES:
            yield drawn_grasp(SENSOR, trial.name, group, scans, references, numbers)


def _free_air(path: Path) -> np.ndarray:
    return capture_taxel_reference(list(read_scans(path)[-FREE_SCANS:]))


def _presses(scan: np.ndarray, reference: np.ndarray) -> bool:
    return bool(np.abs(scan[:, 2] - reference[:, 2]).max() > PRESSED_counts)
