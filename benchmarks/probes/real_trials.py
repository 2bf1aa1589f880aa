"""Real grasps on disk: two uSkins on a Franka hand, pick-and-move trials with slip labels and no force labels."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from benchmarks.probes.uskin_csv import read_uskin_csv
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.markers.reference import capture_taxel_reference
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS, describe
from uniforce_vtla.tokenizer.latent import pool_latent

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
    """One recording, T frames."""

    name: str  # its folder
    counts: np.ndarray  # (2, T, 16, 3) int64 raw, left finger first
    slip: np.ndarray  # (T,) bool, labelled as slipping
    dropped: np.ndarray  # (T,) bool, labelled as failed: the object has left the hand
    joint_speed: np.ndarray  # (T,) rad/s, norm over the arm's joints
    reference: np.ndarray  # (2, 16, 3) int64 free air
    reference_from: str  # "own" or "borrowed from …"

    @property
    def load_range_counts(self) -> float:
        """Range of Σdz over the trial, mean of both fingers."""
        return float(np.ptp(self.counts[..., 2].sum(axis=2), axis=1).mean())


@dataclass(frozen=True)
class Signals:
    """What the fingers measured during a trial, all in the canonical frame."""

    latent: np.ndarray  # (2, T, pool², L) above its value in free air
    descriptor: np.ndarray  # (2, T, 6) in natural units
    counts: np.ndarray  # (2, T, 16, 3) above the reference; the right finger's x with its sign turned
    saturated_frames: int  # frames in which a disc had to be clipped, both fingers


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


def encode_trial(tokenizer: Tokenizer, trial: Trial, config: SlipConfig | None = None) -> Signals:
    """Return a trial's signals: counts → marker images → latents and descriptors, both fingers."""
    config = config or SlipConfig()
    fingers = [_encode_finger(tokenizer, trial, number, config) for number in range(len(FINGERS))]
    latent, descriptor, saturated = zip(*fingers, strict=True)
    counts = (trial.counts - trial.reference[:, None]).astype(np.float64)
    counts[1, ..., 0] *= -1  # the mirror, for raw counts
    return Signals(np.stack(latent), np.stack(descriptor), counts, sum(saturated))


def changes_load(trial: Trial, config: SlipConfig) -> bool:
    """Return whether a trial's normal load changes enough to be compared."""
    return trial.load_range_counts > config.load_change_counts


def _read_tables(path: Path) -> tuple[np.ndarray, pd.DataFrame, np.ndarray]:
    """Return counts (2, T, 16, 3), labels and joint speed (T,) of one trial."""
    counts = [read_uskin_csv(path / log) for log in LOGS.values()]
    labels, state = (_table(path / name) for name in ("slip_label.csv", "robot_state.csv"))
    lengths = {len(counts[0]), len(counts[1]), len(labels), len(state)}
    velocity = state.filter(like="velocity_joint").to_numpy(np.float64)
    if len(lengths) > 1 or velocity.size == 0 or not {"slip", "fail"} <= set(labels.columns):
        raise DatasetError(
            expected(f"{path.name}", "tables of one length with slip, fail, velocity", lengths, "Copy it again.")
        )
    return np.stack(counts), labels, np.linalg.norm(velocity, axis=1)


def _table(path: Path) -> pd.DataFrame:
    if not path.is_file():
        raise DatasetError(expected("trial", path.name, f"no file {path}", "Copy the trial again."))
    return pd.read_csv(path)


def _free_air(counts: np.ndarray, config: SlipConfig) -> np.ndarray:
    """Return the (2, 16, 3) reference of a trial that ends in free air."""
    return np.stack([capture_taxel_reference(scans[-config.free_scans :]) for scans in counts])


def _encode_finger(
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
        [_pooled(tokenizer, free, images[i : i + CHUNK], finger, config.pool) for i in range(0, len(images), CHUNK)]
    )
    rest = _pooled(tokenizer, free, free[None], finger, config.pool)
    descriptor = describe(to_canonical(free, finger), to_canonical(images, finger))
    natural = descriptor / np.asarray(NATURAL_UNITS)
    return latent - rest, natural, canonicalizer.saturation.frames_saturated


@torch.no_grad()
def _pooled(tokenizer: Tokenizer, reference: np.ndarray, images: np.ndarray, finger: Finger, grid: int) -> np.ndarray:
    """Return (n, grid², L) float64."""
    return pool_latent(tokenizer.encode(reference[None], images, finger), grid).double().numpy()
