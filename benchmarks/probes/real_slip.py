"""Real grasps: two uSkins on a Franka hand, seven pick-and-move trials with slip labels and no force labels.

Two questions.  Do both fingers' latents agree on the normal load, as equilibrium says they must?  Does slip show in the
latent?  Raw counts and the hand descriptor answer the same questions by the same rules, and what knows nothing of touch
(joint speed, time) shows what a trial's plan alone gives away.  Seven trials of one lab's boxes, three of which slip:
read all of it as an indication.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.probes.latent_correlation import Rotation
from benchmarks.probes.real_balance import balance_report
from benchmarks.probes.real_trials import Signals, SlipConfig, Trial, feel
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
        rotation: fitted on *simulated* uSkin, see ``latent_correlation.fit_rotation``; its third axis is normal load.
        config: how.

    Raises:
        ContractError: a rotation of another latent size.
        DatasetError: too few slipping trials to leave one out.
    """
    config = config or SlipConfig()
    _check_rotation(rotation, tokenizer)
    signals = [feel(tokenizer, trial, config) for trial in trials]
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
        raise ContractError(
            expected("rotation", (size, size), rotation.matrix.shape, "Fit it on this tokenizer.")
        )
