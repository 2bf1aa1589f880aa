"""Do both fingers agree on the normal load of a real grasp, as equilibrium says they must?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.probes.latent_correlation import Rotation
from benchmarks.probes.real_trials import Signals, SlipConfig, Trial, changes_load


def loads(signals: Signals, rotation: Rotation) -> dict[str, np.ndarray]:
    """Return (2, T, 3) x, y and normal component per signal, each in its own unit."""
    by_hand = signals.descriptor[..., [0, 1, 4]]  # dx, dy, area change
    return {
        "latent": rotation(signals.latent.mean(axis=2))[..., :3],
        "raw counts": signals.counts.sum(axis=2),
        "hand descriptor": by_hand,
    }


def balance_report(
    trials: Sequence[Trial], signals: Sequence[Signals], rotation: Rotation, config: SlipConfig
) -> dict[str, Any]:
    """Return left against right in the trials whose load changes, per signal and component.

    "whole" includes the drop, whose swing alone gives a high r; "held" ends before it.
    """
    changing = [(t, s) for t, s in zip(trials, signals, strict=True) if changes_load(t, config)]
    report: dict[str, Any] = {"trials": [t.name for t, _ in changing], "by_trial": {}, "median": {}}
    for trial, felt in changing:
        report["by_trial"][trial.name] = {
            name: {
                axis: balance(values[0, :, number], values[1, :, number], ~trial.dropped)
                for number, axis in enumerate(("x", "y", "normal"))
            }
            for name, values in loads(felt, rotation).items()
        }
    for name in ("latent", "raw counts", "hand descriptor"):
        found = [entry[name] for entry in report["by_trial"].values()]
        report["median"][name] = {
            axis: {key: float(np.median([f[axis][key] for f in found])) for key in found[0][axis]}
            for axis in ("x", "y", "normal")
        }
    return report


def balance(left: np.ndarray, right: np.ndarray, held: np.ndarray) -> dict[str, float]:
    """Return r and slope (right on left, least squares) over the whole trial and while held, and the held ratio.

    Args:
        left: (T,) one component of the left finger's load.
        right: (T,) likewise.
        held: (T,) bool.
    """
    report: dict[str, float] = {}
    for name, rows in (("whole", np.ones_like(held)), ("held", held)):
        x, y = left[rows] - left[rows].mean(), right[rows] - right[rows].mean()
        report[f"r_{name}"] = float((x @ y) / max(np.sqrt((x @ x) * (y @ y)), 1e-12))
        report[f"slope_{name}"] = float((x @ y) / max(x @ x, 1e-12))
    return report | {"ratio_held": float(right[held].mean() / left[held].mean())}
