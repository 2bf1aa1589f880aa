"""Two real uSkins of one hand: do both fingers read the same force?  Labels of force there are none."""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real.trials import Trial, TrialConfig, changes_load, read_trials
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

HELD = 0.5  # of a trial's largest normal signal: the object is in the grip
FEWEST = 30  # held frames that a correlation needs


def is_grasps(folder: Path) -> bool:
    """Return whether ``folder`` holds trials of two uSkins."""
    return next(folder.glob("*/xela_sensor1.csv"), None) is not None


def balance(tokenizer: Tokenizer, head: ForceHead, folder: Path) -> dict[str, Any]:
    """Return, over held stretches, how the two fingers' forces go together: correlation, and right over left of Fz.

    Raises:
        DatasetError: as ``read_trials``.
    """
    config = TrialConfig()
    trials = [trial for trial in read_trials(folder, config) if changes_load(trial, config)]
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
