"""Linear readouts of depth and shear: fitted on one sensor, read on another, as it is or after ten frames of it."""

from collections.abc import Callable

import numpy as np
import torch
from scipy.stats import spearmanr
from sklearn.linear_model import Ridge
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from tqdm import tqdm

from benchmarks.real.few_frames import ForceCorrection
from benchmarks.real.tactip_shear import TactipSet
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibrate import in_plane_turn_rad
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS, describe
from uniforce_vtla.tokenizer.latent import POOL, pool_latent

RIDGES = (1.0, 100.0)  # on standardised features; both are reported, neither is chosen
FEW_FRAMES, DRAWS = 10, 20  # frames of the new sensor, and how often they are drawn anew
CHUNK = 64
LAST, FIRST = (1, 2, 0), (2, 0, 1)  # depth, shear → shear, depth as forces are ordered, and back
Features = Callable[[TactipSet], np.ndarray]  # → (n, F)


def fit_readout(features: np.ndarray, label: np.ndarray, ridge: float) -> Pipeline:
    """Return ridge regression of (n, F) standardised features on (n, 3) depth, shear x and y in mm, or (n,) labels."""
    return make_pipeline(StandardScaler(), Ridge(ridge)).fit(features, label)


def labels_mm(recording: TactipSet) -> np.ndarray:
    """Return (n, 3): depth, shear x, shear y."""
    return np.column_stack([recording.depth_mm, recording.shear_mm])


def latent_features(tokenizer: Tokenizer) -> Features:
    """Return the pooled latents above their value in free air, as features."""

    def features(recording: TactipSet) -> np.ndarray:
        rest = _pooled(tokenizer, recording.reference, recording.reference[None])
        parts = [recording.current[i : i + CHUNK] for i in range(0, len(recording.current), CHUNK)]
        bar = tqdm(parts, desc=f"encode {recording.name}", leave=False)
        return (
            np.concatenate([_pooled(tokenizer, recording.reference, part) for part in bar]) - rest
        )

    return features


def descriptor_features(recording: TactipSet) -> np.ndarray:
    """Return hand descriptors in natural units, as features."""
    return describe(recording.reference, recording.current) / np.asarray(NATURAL_UNITS)


def head_reading(tokenizer: Tokenizer, head: ForceHead, recording: TactipSet) -> dict[str, float]:
    """Return how the head's newtons, with nothing fitted, go with depth and shear."""
    parts = [recording.current[i : i + CHUNK] for i in range(0, len(recording.current), CHUNK)]
    force = np.concatenate(
        [head(tokenizer.encode(recording.reference[None], part)).numpy() for part in parts]
    )
    return score(np.column_stack([force[:, 2], force[:, :2]]), labels_mm(recording))


def transfer(
    source: tuple[np.ndarray, np.ndarray], target: tuple[np.ndarray, np.ndarray], ridge: float
) -> dict:
    """Return scores on the target of a readout fitted on the source, each (features, labels).

    ``as_is``; ``one_angle``, turned by the angle that fits all of the target's labels best: what a known mount angle
    gives; ``few_frames``, turned, scaled and shifted by what ten labelled frames say, mean over draws of them.
    """
    read, label = fit_readout(*source, ridge).predict(target[0]), target[1]
    turn = in_plane_turn_rad(read[:, 1:], label[:, 1:])
    rng = np.random.default_rng(0)
    few = []
    for _ in range(DRAWS):
        chosen = rng.choice(len(label), FEW_FRAMES, replace=False)
        rest = np.setdiff1d(np.arange(len(label)), chosen)
        found = ForceCorrection.fit(read[chosen][:, LAST], label[chosen][:, LAST])
        few.append(score(found(read[rest][:, LAST])[:, FIRST], label[rest]))
    return {
        "as_is": score(read, label),
        "one_angle": score(_turned(read, turn), label),
        "angle_deg": float(np.degrees(turn)),
        "few_frames": {name: float(np.mean([f[name] for f in few])) for name in few[0]},
    }


def score(read_mm: np.ndarray, label_mm: np.ndarray) -> dict[str, float]:
    """Return rank of depth, |r| of shear (mean of both axes), R² and mean error of each."""
    r = [abs(np.corrcoef(read_mm[:, k], label_mm[:, k])[0, 1]) for k in (1, 2)]
    error = read_mm - label_mm
    r2 = 1 - (error**2).mean(axis=0) / label_mm.var(axis=0)
    return {
        "depth_rank": float(spearmanr(read_mm[:, 0], label_mm[:, 0])[0]),
        "shear_r": float(np.mean(r)),
        "depth_r2": float(r2[0]),
        "shear_r2": float(r2[1:].mean()),
        "depth_mae_mm": float(np.abs(error[:, 0]).mean()),
        "shear_mae_mm": float(np.abs(error[:, 1:]).mean()),
    }


def _turned(read: np.ndarray, turn_rad: float) -> np.ndarray:
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return np.column_stack([read[:, 0], read[:, 1:] @ np.array([[cos, sin], [-sin, cos]])])


@torch.no_grad()
def _pooled(tokenizer: Tokenizer, reference: np.ndarray, current: np.ndarray) -> np.ndarray:
    return pool_latent(tokenizer.encode(reference[None], current), POOL).flatten(1).double().numpy()
