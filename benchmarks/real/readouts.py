"""Linear readouts of depth and shear: fitted on one sensor, read on another.

The other sensor is read as it is, or after ten labelled frames of it.
"""

from collections.abc import Callable, Iterator

import numpy as np
import torch
from scipy.stats import spearmanr
from sklearn.linear_model import Ridge
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler
from tqdm import tqdm

from benchmarks.real.few_frames import ForceCorrection, turned
from benchmarks.real.tactip_shear import TactipSet
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibrate import in_plane_turn_rad
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS, describe
from uniforce_vtla.tokenizer.latent import POOL, pool_latent

RIDGES = (1.0, 100.0)  # on standardised features; both are reported, neither is chosen
FEW_FRAMES = 10  # of the new sensor
DRAWS = 20  # of these frames
CHUNK = 64
LAST = (1, 2, 0)  # depth, shear → shear, depth, as forces are ordered
FIRST = (2, 0, 1)  # and back
Features = Callable[[TactipSet], np.ndarray]  # → (n, F)


def fit_readout(features: np.ndarray, label: np.ndarray, ridge: float) -> Pipeline:
    """Return ridge regression of standardised (n, F) features on (n, 3) or (n,) labels."""
    return make_pipeline(StandardScaler(), Ridge(ridge)).fit(features, label)


def labels_mm(recording: TactipSet) -> np.ndarray:
    """Return (n, 3): depth, shear x, shear y."""
    return np.column_stack([recording.depth_mm, recording.shear_mm])


def chunks(images: np.ndarray) -> Iterator[np.ndarray]:
    """Yield ``CHUNK`` images at a time, with a bar."""
    for first in tqdm(range(0, len(images), CHUNK), desc="encode", leave=False):
        yield images[first : first + CHUNK]


@torch.no_grad()
def pooled(tokenizer: Tokenizer, reference: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return pooled latents (n, F) of (n, 480, 640) images against one reference (480, 640)."""
    rows = []
    for part in chunks(current):
        rows.append(pool_latent(tokenizer.encode(reference[None], part), POOL).flatten(1))
    return torch.cat(rows).double().numpy()


def latent_features(tokenizer: Tokenizer) -> Features:
    """Return the pooled latents above their value in free air, as features."""

    def features(recording: TactipSet) -> np.ndarray:
        rest = pooled(tokenizer, recording.reference, recording.reference[None])
        return pooled(tokenizer, recording.reference, recording.current) - rest

    return features


def descriptor_features(recording: TactipSet) -> np.ndarray:
    """Return hand descriptors in natural units, as features."""
    return describe(recording.reference, recording.current) / np.asarray(NATURAL_UNITS)


def head_reading(tokenizer: Tokenizer, head: ForceHead, recording: TactipSet) -> dict[str, float]:
    """Return how the head's newtons, with nothing fitted, go with depth and shear."""
    rows = []
    for part in chunks(recording.current):
        rows.append(head(tokenizer.encode(recording.reference[None], part)).numpy())
    return score(np.concatenate(rows)[:, FIRST], labels_mm(recording))


def transfer(
    source: tuple[np.ndarray, np.ndarray], target: tuple[np.ndarray, np.ndarray], ridge: float
) -> dict:
    """Return scores on the target of a readout fitted on the source, each (features, labels).

    ``as_is``; ``one_angle``, turned by the angle that fits all of the target's labels best, as a
    known mount gives; ``few_frames``, turned, scaled and shifted by ten labelled frames, mean over
    draws of them.
    """
    features, label = target
    read = fit_readout(*source, ridge).predict(features)
    turn = in_plane_turn_rad(read[:, 1:], label[:, 1:])
    rng = np.random.default_rng(0)
    few = []
    for _ in range(DRAWS):
        chosen = rng.choice(len(label), FEW_FRAMES, replace=False)
        rest = np.setdiff1d(np.arange(len(label)), chosen)
        correct = ForceCorrection.fit(read[chosen][:, LAST], label[chosen][:, LAST])
        few.append(score(correct(read[rest][:, LAST])[:, FIRST], label[rest]))
    return {
        "as_is": score(read, label),
        "one_angle": score(turned(read[:, LAST], turn)[:, FIRST], label),
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
