"""Real grasps: two uSkins on a Franka hand, seven pick-and-move trials with slip labels and no force labels.

Two questions.  Do both fingers' latents agree on the normal load, as equilibrium says they must?  Does slip show in the
latent?  Raw counts and the hand descriptor answer the same questions by the same rules, and what knows nothing of touch
(joint speed, time) shows what a trial's plan alone gives away.  Seven trials of one lab's boxes, three of which slip:
read all of it as an indication.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from scipy.optimize import minimize
from scipy.stats import rankdata

from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.markers.reference import capture_taxel_reference
from uniforce_vtla.probes.descriptor import NATURAL_UNITS, describe
from uniforce_vtla.probes.latent_correlation import Rotation
from uniforce_vtla.sensors.uskin_csv import read_uskin_csv
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.pooling import pool_latent

LOGS: dict[Finger, str] = {"left": "xela_sensor1.csv", "right": "xela_sensor2.csv"}
CHUNK = 64  # frames encoded at once
RATE_HZ = 60.0  # of the logs; their own metadata say 59.7 to 60


@dataclass(frozen=True)
class SlipConfig:
    """How trials are read and slip is looked for; set once, none of it tuned on the labels."""

    free_scans: int = 10  # last scans of a trial that ended in a drop: its own free-air reference
    lender: str = "data_sample_2022-02-22-15-15-00"  # lends its reference to trials that never let go
    load_change_counts: float = 1000.0  # range of Σdz: quiet trials stay below 800, the others exceed 1,700
    windows: tuple[int, ...] = (1, 3, 6, 12)  # frames looked back; 17 to 200 ms at 60 Hz
    pool: int = 4  # regions per side of the latent map the detector sees: what the policy sees
    onset_frames: int = 15  # 0.25 s; the first of each slip
    ridge: float = 1.0  # on standardised weights of the logistic regression
    false_alarms: float = 0.01  # share of the training trials' quiet frames that sets the alarm's level


@dataclass(frozen=True)
class Trial:
    """One recording, T frames.

    Attributes:
        name: its folder.
        counts: (2, T, 16, 3) int64 raw, left finger first.
        slip: (T,) bool, labelled as slipping.
        dropped: (T,) bool, labelled as failed: the object has left the hand.
        joint_speed: (T,) rad/s, norm over the arm's joints.
        reference: (2, 16, 3) int64 free air.
        reference_from: "own" or "borrowed from …".
    """

    name: str
    counts: np.ndarray
    slip: np.ndarray
    dropped: np.ndarray
    joint_speed: np.ndarray
    reference: np.ndarray
    reference_from: str

    @property
    def load_range_counts(self) -> float:
        """Range of Σdz over the trial, mean of both fingers."""
        return float(np.ptp(self.counts[..., 2].sum(axis=2), axis=1).mean())


@dataclass(frozen=True)
class Signals:
    """What was felt during a trial, all in the canonical frame.

    Attributes:
        latent: (2, T, pool², L) above its value in free air.
        descriptor: (2, T, 6) in natural units.
        counts: (2, T, 16, 3) above the reference; the right finger's x with its sign turned.
        saturated_frames: frames in which a disc had to be clipped, both fingers.
    """

    latent: np.ndarray
    descriptor: np.ndarray
    counts: np.ndarray
    saturated_frames: int


def read_trials(folder: Path, config: SlipConfig | None = None) -> list[Trial]:
    """Return all trials of a ``data_set`` folder, by name.

    Raises:
        DatasetError: no trials, no lender, or tables of different length.
        SensorError: a log that isn't uSkin counts, or a free-air stretch that isn't steady.
    """
    config = config or SlipConfig()
    paths = sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    if config.lender not in [path.name for path in paths]:
        raise DatasetError(expected(f"trials in {folder}", config.lender, "none", "Check the path."))
    tables = {path.name: _read_tables(path) for path in paths}
    own = {
        name: _free_air(counts, config)
        for name, (counts, labels, _) in tables.items()
        if (labels["fail"].to_numpy()[-config.free_scans :] > 0).all()
    }
    if config.lender not in own:
        raise DatasetError(expected(config.lender, "a trial that ends in a drop", "none", "Choose another."))
    return [
        Trial(
            name,
            counts,
            labels["slip"].to_numpy() > 0,
            labels["fail"].to_numpy() > 0,
            speed,
            own.get(name, own[config.lender]),
            "own" if name in own else f"borrowed from {config.lender}",
        )
        for name, (counts, labels, speed) in tables.items()
    ]


def feel(tokenizer: Tokenizer, trial: Trial, config: SlipConfig | None = None) -> Signals:
    """Return a trial's signals: counts → marker images → latents and descriptors, both fingers."""
    config = config or SlipConfig()
    fingers = [_feel_finger(tokenizer, trial, number, config) for number in range(len(FINGERS))]
    latent, descriptor, saturated = zip(*fingers, strict=True)
    counts = (trial.counts - trial.reference[:, None]).astype(np.float64)
    counts[1, ..., 0] *= -1  # the mirror, for raw counts
    return Signals(np.stack(latent), np.stack(descriptor), counts, sum(saturated))


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


# -- (a) balance -----------------------------------------------------------------------------------------


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


def changes_load(trial: Trial, config: SlipConfig) -> bool:
    """Return whether a trial's normal load changes enough to be compared."""
    return trial.load_range_counts > config.load_change_counts


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


# -- (b) slip --------------------------------------------------------------------------------------------


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
        seen, asked = np.log1p(x / scale), np.log1p(own / scale)
        mean, std = seen.mean(axis=0), np.maximum(seen.std(axis=0), 1e-9)
        weight = fit_logistic((seen - mean) / std, y, config.ridge)
        quiet = _odds((seen - mean) / std, weight)[~y]
        scores.append(
            (_odds((asked - mean) / std, weight), float(np.quantile(quiet, 1 - config.false_alarms)))
        )
    return scores


def fit_logistic(x: np.ndarray, y: np.ndarray, ridge: float) -> np.ndarray:
    """Return (F + 1,) weights, the offset last; both classes weigh the same however rare one is."""
    share = np.where(y, 0.5 / y.mean(), 0.5 / (1 - y.mean()))
    sign = np.where(y, 1.0, -1.0)

    def loss(weight: np.ndarray) -> tuple[float, np.ndarray]:
        margin = sign * _odds(x, weight)
        pull = -share * sign / (1 + np.exp(np.clip(margin, -500, 500)))  # d loss / d odds
        gradient = np.append(x.T @ pull + ridge * weight[:-1], pull.sum())
        return float(
            (share * np.logaddexp(0, -margin)).sum() + ridge / 2 * weight[:-1] @ weight[:-1]
        ), gradient

    return minimize(loss, np.zeros(x.shape[1] + 1), jac=True, method="L-BFGS-B").x


def auroc(scores: np.ndarray, labels: np.ndarray) -> float | None:
    """Return the area under the ROC curve, ties counted half; None where one class is missing."""
    positive = int(labels.sum())
    negative = len(labels) - positive
    if not positive or not negative:
        return None
    return float((rankdata(scores)[labels].sum() - positive * (positive + 1) / 2) / (positive * negative))


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


def _odds(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return x @ weight[:-1] + weight[-1]


# -- reading ---------------------------------------------------------------------------------------------


def _read_tables(path: Path) -> tuple[np.ndarray, pd.DataFrame, np.ndarray]:
    """Return counts (2, T, 16, 3), labels and joint speed (T,) of one trial."""
    counts = [read_uskin_csv(path / log) for log in LOGS.values()]
    labels, state = (_table(path / name) for name in ("slip_label.csv", "robot_state.csv"))
    lengths = {len(counts[0]), len(counts[1]), len(labels), len(state)}
    velocity = state.filter(like="velocity_joint").to_numpy(np.float64)
    if len(lengths) > 1 or velocity.size == 0 or not {"slip", "fail"} <= set(labels.columns):
        raise DatasetError(
            expected(
                f"{path.name}", "tables of one length with slip, fail, velocity", lengths, "Copy it again."
            )
        )
    return np.stack(counts), labels, np.linalg.norm(velocity, axis=1)


def _table(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise DatasetError(expected("trial", path.name, f"no file {path}", "Copy the trial again."))
    return pd.read_csv(path)


def _free_air(counts: np.ndarray, config: SlipConfig) -> np.ndarray:
    """Return the (2, 16, 3) reference of a trial that ends in free air."""
    return np.stack([capture_taxel_reference(scans[-config.free_scans :]) for scans in counts])


def _feel_finger(
    tokenizer: Tokenizer, trial: Trial, number: int, config: SlipConfig
) -> tuple[np.ndarray, np.ndarray, int]:
    finger, reference = FINGERS[number], trial.reference[number]
    canonicalizer = Canonicalizer("uskin")
    pairs = [
        canonicalizer.pair(reference, scan, finger, reference_from=trial.reference_from)
        for scan in trial.counts[number]
    ]
    free, images = pairs[0].reference, np.stack([pair.current for pair in pairs])
    latent = np.concatenate(
        [
            _pooled(tokenizer, free, images[i : i + CHUNK], finger, config.pool)
            for i in range(0, len(images), CHUNK)
        ]
    )
    rest = _pooled(tokenizer, free, free[None], finger, config.pool)
    descriptor = describe(to_canonical(free, finger), to_canonical(images, finger))
    natural = descriptor / np.asarray(NATURAL_UNITS)
    return latent - rest, natural, canonicalizer.saturation.frames_saturated


@torch.no_grad()
def _pooled(
    tokenizer: Tokenizer, reference: np.ndarray, images: np.ndarray, finger: Finger, grid: int
) -> np.ndarray:
    """Return (n, grid², L) float64."""
    return pool_latent(tokenizer.encode(reference[None], images, finger), grid).double().numpy()


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
