"""Readers of normal force for real grasps: one head each, trained on the same simulated presses.

The tokenizer stands beside an untrained encoder of its size and six hand-made numbers. A head reads each frame alone.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.report_sets import REPORT_SETS
from benchmarks.probes.zero_shot import descriptor_features, encode_set, sized_head
from benchmarks.real.grasps import SENSOR, Reader
from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.force_head import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.latent import POOL, pool_latent
from uniforce_vtla.tokenizer.plain_touch import descriptors

SET = REPORT_SETS["zero_shot_v2"]  # whose training presses, of seen indenters, the heads learn from
BATCH = 16

# reference (480, 640), current (T, 480, 640), finger → (T, P, L)
Encode = Callable[[np.ndarray, np.ndarray, Finger], torch.Tensor]


def simulated_presses(side: int, cache: Path, sensor: str = SENSOR) -> LabelledSet:
    """Return the presses of a sensor that heads learn from; they are drawn into ``cache`` once."""
    sensors = {sensor: SET.sources()[sensor]}
    return SET.draw(SET.training, sensors, side, cache)[sensor]


def latent_reader(tokenizer: Tokenizer, presses: LabelledSet, seed: int) -> Reader:
    """Return a reader of normal force: the tokenizer and a head trained on simulated presses."""
    z = encode_set(tokenizer, presses)  # (n, T, P, L)
    config = sized_head(HeadTrainingConfig(), z, POOL)
    return _reader(_latents(tokenizer), train_head(z, presses.force_N, config, seed))


def described_reader(presses: LabelledSet, seed: int) -> Reader:
    """Return a reader of normal force from six hand-made numbers, trained on the same presses."""
    z = descriptor_features(presses)  # (n, T, 1, 6)
    # no spread below one natural unit is signal
    plain = replace(HeadTrainingConfig(), smallest_spread=1.0)
    return _reader(_described, train_head(z, presses.force_N, sized_head(plain, z, 1), seed))


def grasp_readers(
    tokenizer: Tokenizer, seed: int, cache: Path, sensor: str = SENSOR
) -> dict[str, Reader]:
    """Return name → reader of a sensor, the tokenizer's first."""
    presses = simulated_presses(tokenizer.config.side, cache, sensor)
    return {
        "tokenizer": latent_reader(tokenizer, presses, seed),
        "untrained encoder": latent_reader(Tokenizer.random(tokenizer.config, seed), presses, seed),
        "hand descriptor": described_reader(presses, seed),
    }


def _latents(tokenizer: Tokenizer) -> Encode:
    def encode(reference: np.ndarray, current: np.ndarray, finger: Finger) -> torch.Tensor:
        parts = [current[first : first + BATCH] for first in range(0, len(current), BATCH)]
        encoded = [
            pool_latent(tokenizer.encode(reference[None], part, finger), POOL) for part in parts
        ]
        return torch.cat(encoded).as_subclass(torch.Tensor)  # (T, P, L)

    return encode


def _described(reference: np.ndarray, current: np.ndarray, finger: Finger) -> torch.Tensor:
    # (T, 6)
    numbers = np.concatenate([descriptors(reference, image[None], finger) for image in current])
    natural = numbers / np.asarray(NATURAL_UNITS, np.float32)
    return torch.from_numpy(natural)[:, None].float()  # (T, 1, 6)


def _reader(encode: Encode, model: torch.nn.Module) -> Reader:
    @torch.no_grad()
    def read(reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        z = encode(reference, current, finger)
        force_N: torch.Tensor = model(z[:, None])[:, 0]  # (T, 3): each frame is a sequence of one
        return force_N[:, 2].double().numpy()

    return read
