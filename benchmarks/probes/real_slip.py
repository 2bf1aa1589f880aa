"""Real grasps: two uSkins on a Franka hand, seven pick-and-move trials with slip labels and no force labels.

Two questions.  Do both fingers' latents agree on the normal load, as equilibrium says they must?  Does slip show in the
latent?  Raw counts and the hand descriptor answer the same questions by the same rules, and what knows nothing of touch
(joint speed, time) shows what a trial's plan alone gives away.  Seven trials of one lab's boxes, three of which slip:
read all of it as an indication.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.probes.latent_rotation import Rotation
from benchmarks.probes.real_trials import Signals, SlipConfig, Trial, changes_load, encode_trial
from benchmarks.probes.slip_detector import slip_report, starts
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.api import Tokenizer


def real_slip(
    tokenizer: Tokenizer, trials: Sequence[Trial], rotation: Rotation, config: SlipConfig | None = None
) -> tuple[dict[str, Any], list[Signals], dict[str, list[np.ndarray]]]:
    """Return the numbers, and for the figure every trial's signals and out-of-trial slip scores.

    Args:
        tokenizer: what is examined.
        trials: from ``read_trials``.
        rotation: fitted on *simulated* uSkin, see ``latent_rotation.fit_rotation``; its third axis is normal load.
        config: how.

    Raises:
        ContractError: a rotation of another latent size.
        DatasetError: too few slipping trials to leave one out.
    """
    config = config or SlipConfig()
    _check_rotation(rotation, tokenizer)
    signals = [encode_trial(tokenizer, trial, config) for trial in trials]
    slip, scores = slip_report(trials, signals, config)
    return (
        {
            "what": "real uSkin recordings; no force labels; the rotation was fitted on simulated uSkin",
            "tokenizer_hash": tokenizer.hash,
            "trials": [_trial_facts(t, s) for t, s in zip(trials, signals, strict=True)],
            "own_references_differ_counts": _reference_gap(trials),
            "balance": balance_report(trials, signals, rotation, config),
            "slip": slip,
        },
        signals,
        scores,
    )


def _trial_facts(trial: Trial, signals: Signals) -> dict[str, Any]:
    return {
        "name": trial.name,
        "frames": len(trial.slip),
        "reference_from": trial.reference_from,
        "load_range_counts": trial.load_range_counts,
        "slip_onsets": len(starts(trial.slip)),
        "dropped": bool(trial.dropped.any()),
        "saturated_frames": signals.saturated_frames,
    }


def _reference_gap(trials: Sequence[Trial]) -> float | None:
    """Return the largest |ΔΣdz| between trials' own references: what a borrowed one may be wrong by."""
    own = [t.reference[..., 2].sum(axis=1) for t in trials if t.reference_from == "own"]
    if len(own) < 2:
        return None
    return float(np.ptp(np.stack(own), axis=0).max())


def _check_rotation(rotation: Rotation, tokenizer: Tokenizer) -> None:
    size = tokenizer.config.latent
    if rotation.matrix.shape != (size, size):
        raise ContractError(expected("rotation", (size, size), rotation.matrix.shape, "Fit it on this tokenizer."))


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
    for trial, signal in changing:
        report["by_trial"][trial.name] = {
            name: {
                axis: balance(values[0, :, number], values[1, :, number], ~trial.dropped)
                for number, axis in enumerate(("x", "y", "normal"))
            }
            for name, values in loads(signal, rotation).items()
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
