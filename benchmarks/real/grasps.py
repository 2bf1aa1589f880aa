"""Real grasps without labels: two uSkins of one Franka hand. Do both fingers read the same force?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from uniforce_vtla.contracts import FINGERS, TAXEL_SHAPE, Finger
from uniforce_vtla.errors import DatasetError, SensorError, UniForceError, expected
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.reference import capture_taxel_reference
from uniforce_vtla.tokenizer import ForceHead, Tokenizer

LOGS: dict[Finger, str] = {"left": "xela_sensor1.csv", "right": "xela_sensor2.csv"}
COLUMNS = [f"txl{taxel}_{axis}" for taxel in range(1, TAXEL_SHAPE[0] + 1) for axis in "xyz"]
# How trials are read; set once, none of it tuned on the labels
FREE_SCANS = 10  # last scans of a trial that ended in a drop: its own free-air reference
LENDER = "data_sample_2022-02-22-15-15-00"  # lends its reference to trials that never let go
LOAD_CHANGE_COUNTS = 1000.0  # range of Σdz: quiet trials stay below 800, the others exceed 1,700
HELD = 0.5  # of a trial's largest normal signal: the object is in the grip
FEWEST = 30  # held frames that a correlation needs


@dataclass(frozen=True)
class Trial:
    """One recording, T frames."""

    name: str  # its folder
    counts: np.ndarray  # (2, T, 16, 3) int64 raw, left finger first
    reference: np.ndarray  # (2, 16, 3) int64 free air
    reference_from: str  # "own" or "borrowed from …"

    @property
    def changes_load(self) -> bool:
        """Whether the normal load, Σdz, mean of both fingers, changes enough to be compared."""
        return float(np.ptp(self.counts[..., 2].sum(axis=2), axis=1).mean()) > LOAD_CHANGE_COUNTS


def read_trials(folder: Path, lender: str = LENDER) -> list[Trial]:
    """Return all trials of a ``data_set`` folder, by name.

    Raises DatasetError: no trials, no lender, or tables of different length; SensorError: a log that isn't uSkin
    counts, or a free-air stretch that isn't steady.
    """
    paths = sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    if lender not in [path.name for path in paths]:
        raise DatasetError(expected(f"trials in {folder}", lender, "none", "Check the path."))
    tables = {path.name: _read_tables(path) for path in paths}
    own = {
        name: np.stack([capture_taxel_reference(scans[-FREE_SCANS:]) for scans in counts])
        for name, (counts, labels) in tables.items()
        if (labels["fail"].to_numpy()[-FREE_SCANS:] > 0).all()
    }
    if lender not in own:
        raise DatasetError(expected(lender, "a trial that ends in a drop", "none", "Choose another."))
    return [
        Trial(name, counts, own.get(name, own[lender]), "own" if name in own else f"borrowed from {lender}")
        for name, (counts, _) in tables.items()
    ]


def _read_tables(path: Path) -> tuple[np.ndarray, pd.DataFrame]:
    counts = [read_uskin_csv(path / log) for log in LOGS.values()]
    labels = _read_table(path / "slip_label.csv", DatasetError)
    lengths = {len(counts[0]), len(counts[1]), len(labels)}
    if len(lengths) > 1 or "fail" not in labels.columns:
        raise DatasetError(expected(path.name, "tables of one length with fail", lengths, "Copy it again."))
    return np.stack(counts), labels


def read_uskin_csv(path: Path | str) -> np.ndarray:
    """Return a trial's raw counts, (N, 16, 3) int64; extra columns are left aside.

    Raises SensorError: no such file, a missing column, no rows, or a value that isn't a whole number.
    """
    table = _read_table(Path(path), SensorError)
    missing = [column for column in COLUMNS if column not in table.columns]
    if missing:
        do = "Is this a uSkin 4×4 log?"
        raise SensorError(expected(f"{path}", "columns txl1_x … txl16_z", f"{missing[0]} missing", do))
    values = table[COLUMNS].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)  # (N, 48)
    if len(values) == 0 or not np.isfinite(values).all() or np.any(values != np.rint(values)):
        came = "no rows" if len(values) == 0 else "missing or fractional values"
        do = "Log the raw signal again."
        raise SensorError(expected(f"{path}", "whole counts in every cell", came, do))
    return values.astype(np.int64).reshape(-1, *TAXEL_SHAPE)  # (N, 16, 3)


def _read_table(path: Path, failure: type[UniForceError]) -> pd.DataFrame:
    if not path.is_file():
        raise failure(expected(path.name, "a csv file", f"no file {path}", "Check the path."))
    try:
        return pd.read_csv(path)
    except pd.errors.EmptyDataError as error:
        raise failure(expected(str(path), "a csv table", "an empty file", "Log the trial again.")) from error


def is_grasps(folder: Path) -> bool:
    return next(folder.glob("*/xela_sensor1.csv"), None) is not None


def balance(tokenizer: Tokenizer, head: ForceHead, folder: Path) -> dict[str, Any]:
    """Return, over held stretches, how the two fingers' forces go together: correlation, and right over left of Fz.

    Raises DatasetError: as ``read_trials``.
    """
    trials = [trial for trial in read_trials(folder) if trial.changes_load]
    rows = [row for row in (_balance(tokenizer, head, trial) for trial in trials) if row is not None]
    r, ratio = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    return {
        "trials": len(rows),
        "median_r": dict(zip(("x", "y", "z"), np.median(r, axis=0).round(3).tolist(), strict=True)),
        "right_over_left_Fz": np.quantile(ratio, (0.1, 0.5, 0.9)).round(3).tolist(),
    }


def _balance(tokenizer: Tokenizer, head: ForceHead, trial: Trial) -> tuple[np.ndarray, float] | None:
    load = trial.counts[..., 2].sum(axis=(0, 2)) - trial.reference[..., 2].sum()
    held = np.flatnonzero(load > HELD * load.max())
    if len(held) < FEWEST:
        return None
    left, right = (_forces(tokenizer, head, trial, number, held) for number in range(len(FINGERS)))
    r = np.array([np.corrcoef(left[:, k], right[:, k])[0, 1] for k in range(3)])
    return r, float(right[:, 2].mean() / left[:, 2].mean())


def _forces(tokenizer: Tokenizer, head: ForceHead, trial: Trial, number: int, frames: np.ndarray) -> np.ndarray:
    """Return (n, 3) of one finger in the canonical frame."""
    canonicalizer, reference = Canonicalizer("uskin"), trial.reference[number]
    pairs = [
        canonicalizer.pair(reference, scan, FINGERS[number], trial.reference_from)
        for scan in trial.counts[number][frames]
    ]
    current = np.stack([pair.current for pair in pairs])
    return head(tokenizer.encode(pairs[0].reference[None], current, FINGERS[number])).numpy()
