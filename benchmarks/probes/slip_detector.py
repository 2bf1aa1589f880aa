"""A simple slip detector on any signal, scored on trials it never saw."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import roc_auc_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmarks.probes.real_trials import RATE_HZ, Signals, SlipConfig, Trial
from uniforce_vtla.errors import DatasetError, expected


def slip_report(
    trials: Sequence[Trial], signals: Sequence[Signals], config: SlipConfig
) -> tuple[dict[str, Any], dict[str, list[np.ndarray]]]:
    """Return AUROC per signal, every trial scored by a detector that never saw it, and the scores.

    Frames after the drop are left out: the hand is empty.
    """
    slips = [trial.slip for trial in trials]
    kept = [~trial.dropped for trial in trials]
    scores = {
        name: leave_one_out(rows, slips, kept, config)
        for name, rows in _detector_inputs(trials, signals, config).items()
    }
    onsets = sum(len(starts(slip)) for slip in slips)
    return {
        "trials": len(trials),
        "slipping_trials": sum(bool(slip.any()) for slip in slips),
        "onsets": onsets,
        "frames": int(sum(k.sum() for k in kept)),
        "slip_frames": int(sum((s & k).sum() for s, k in zip(slips, kept, strict=True))),
        "windows_frames": list(config.windows),
        "detectors": {
            name: _detector_report(trials, [s for s, _ in out], [a for _, a in out], config)
            for name, out in scores.items()
        },
    }, {name: [score for score, _ in out] for name, out in scores.items()}


def change_energy(signal: np.ndarray, windows: Sequence[int]) -> np.ndarray:
    """Return (T, 2·W) rms change of a (2, T, D) signal over each window, per finger; looks back only."""
    T = signal.shape[1]
    columns = []
    for window in windows:
        past = np.maximum(np.arange(T) - window, 0)
        columns.append(np.sqrt(((signal - signal[:, past]) ** 2).mean(axis=2)))  # (2, T)
    return np.concatenate(columns).T


def leave_one_out(
    features: Sequence[np.ndarray],
    labels: Sequence[np.ndarray],
    kept: Sequence[np.ndarray],
    config: SlipConfig,
) -> list[tuple[np.ndarray, float]]:
    """Return per trial its frames' log odds (T,) and the alarm level, both from the other trials alone.

    Both classes weigh the same, however rare one is.

    Args:
        features: per trial (T, F), none negative.
        labels: per trial (T,) bool.
        kept: per trial (T,) bool, which frames count.
        config: ridge and false alarms.

    Raises:
        DatasetError: the other trials hold only one class.
    """
    scores = []
    for number, own in enumerate(features):
        others = [i for i in range(len(features)) if i != number]
        x = np.concatenate([features[i][kept[i]] for i in others])
        y = np.concatenate([labels[i][kept[i]] for i in others])
        if y.all() or not y.any():
            raise DatasetError(expected("training trials", "slip and no slip", "one class", "Add trials."))
        scale = np.maximum(np.median(x, axis=0), 1e-9)
        detector = make_pipeline(
            StandardScaler(),
            LogisticRegression(C=1 / config.ridge, class_weight="balanced", tol=1e-6, max_iter=1000),
        ).fit(np.log1p(x / scale), y)
        quiet = detector.decision_function(np.log1p(x[~y] / scale))
        odds = detector.decision_function(np.log1p(own / scale))
        scores.append((odds, float(np.quantile(quiet, 1 - config.false_alarms))))
    return scores


def auroc(scores: np.ndarray, labels: np.ndarray) -> float | None:
    """Return the area under the ROC curve; None where one class is missing."""
    return float(roc_auc_score(labels, scores)) if labels.any() and not labels.all() else None


def starts(slip: np.ndarray) -> list[int]:
    """Return the first frame of every stretch of True."""
    return [int(i) for i in np.flatnonzero(slip & ~np.append(False, slip[:-1]))]


def _detector_inputs(
    trials: Sequence[Trial], signals: Sequence[Signals], config: SlipConfig
) -> dict[str, list[np.ndarray]]:
    """Return per detector its (T, F) features of every trial."""

    def energy(pick: Any) -> list[np.ndarray]:
        return [change_energy(pick(s), config.windows) for s in signals]

    return {
        "latent": energy(lambda s: s.latent.reshape(*s.latent.shape[:2], -1)),
        "latent, pad mean": energy(lambda s: s.latent.mean(axis=2)),
        "hand descriptor": energy(lambda s: s.descriptor),
        "raw counts": energy(lambda s: s.counts.reshape(*s.counts.shape[:2], -1)),
        "control: joint speed": [t.joint_speed[:, None] for t in trials],
        "control: time": [np.arange(len(t.slip), dtype=float)[:, None] for t in trials],
    }


def _detector_report(
    trials: Sequence[Trial], scores: Sequence[np.ndarray], alarms: Sequence[float], config: SlipConfig
) -> dict[str, Any]:
    kept = [~t.dropped for t in trials]
    early = [k & (~t.slip | _onset(t.slip, config.onset_frames)) for t, k in zip(trials, kept, strict=True)]
    quiet = [k & ~t.slip for t, k in zip(trials, kept, strict=True)]

    def pooled(rows: Sequence[np.ndarray]) -> float | None:
        both = [(s[r], t.slip[r]) for s, r, t in zip(scores, rows, trials, strict=True)]
        return auroc(*(np.concatenate(column) for column in zip(*both, strict=True)))

    raised = np.concatenate([s[q] > a for s, q, a in zip(scores, quiet, alarms, strict=True)])
    each = {t.name: auroc(s[k], t.slip[k]) for t, s, k in zip(trials, scores, kept, strict=True)}
    return {
        "auroc": pooled(kept),
        "auroc_onset": pooled(early),
        "auroc_by_trial": {name: value for name, value in each.items() if value is not None},
        "onset_delays_s": [
            delay
            for t, s, a in zip(trials, scores, alarms, strict=True)
            for delay in _delays(s > a, t.slip, config.onset_frames)
        ],
        "false_alarm_share": float(raised.mean()),
    }


def _delays(alarm: np.ndarray, slip: np.ndarray, within: int) -> list[float | None]:
    """Return per onset the seconds until the first alarm, None where none comes within ``within`` frames."""
    rows = [np.flatnonzero(alarm[start : start + within]) for start in starts(slip)]
    return [float(found[0]) / RATE_HZ if len(found) else None for found in rows]


def _onset(slip: np.ndarray, frames: int) -> np.ndarray:
    """Return (T,) bool: the first ``frames`` frames of every slip."""
    early = np.zeros_like(slip)
    for start in starts(slip):
        early[start : start + frames] = True
    return early & slip
