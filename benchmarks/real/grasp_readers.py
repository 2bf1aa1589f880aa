"""Readers of normal force for real grasps: one head each, trained on the same simulated presses.

The tokenizer stands beside an untrained encoder of its size and six hand-made numbers. A head
reads each frame alone.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.probes.report_sets import REPORT_SETS
from benchmarks.probes.zero_shot import descriptor_features, encode_set, sized_head
from benchmarks.real.grasps import SENSOR, Reader
from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS, descriptors
from uniforce_vtla.tokenizer.force_head import HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.latent import POOL

SET = REPORT_SETS["zero_shot_v2"]  # the heads learn from its training presses, seen indenters
BATCH = 16

# reference (480, 640), current (T, 480, 640), finger → (T, P, L)
Encode = Callable[[np.ndarray, np.ndarray, Finger], torch.Tensor]


def grasp_readers(
    tokenizer: Tokenizer, seed: int, cache: Path, sensor: str = SENSOR
) -> dict[str, Reader]:
    """Return name → reader of a sensor, the tokenizer's first; presses are drawn into ``cache``."""
    sensors = {sensor: SET.sources()[sensor]}
    presses = SET.draw(SET.training, sensors, tokenizer.config.side, cache)[sensor]
    readers = {}
    encoders = {
        "tokenizer": tokenizer,
        "untrained encoder": Tokenizer.random(tokenizer.config, seed),
    }
    for name, encoder in encoders.items():
        z = encode_set(encoder, presses)  # (n, T, P, L)
        head = train_head(z, presses.force_N, sized_head(HeadTrainingConfig(), z, POOL), seed)
        readers[name] = _reader(encode_in_batches(encoder), head)
    z = descriptor_features(presses)  # (n, T, 1, 6)
    # no spread below one natural unit is signal
    plain = replace(HeadTrainingConfig(), smallest_spread=1.0)
    head = train_head(z, presses.force_N, sized_head(plain, z, 1), seed)
    readers["hand descriptor"] = _reader(_described, head)
    return readers


def encode_in_batches(tokenizer: Tokenizer) -> Encode:
    """Return what encodes a finger's marker images, ``BATCH`` at a time."""
    pooled = tokenizer.pooled

    def encode(reference: np.ndarray, current: np.ndarray, finger: Finger) -> torch.Tensor:
        rows = []
        for first in range(0, len(current), BATCH):
            z = pooled(reference, current[first : first + BATCH], finger)
            rows.append(z.as_subclass(torch.Tensor))
        return torch.cat(rows)  # (T, P, L)

    return encode


def _described(reference: np.ndarray, current: np.ndarray, finger: Finger) -> torch.Tensor:
    rows = [descriptors(reference, image[None], finger) for image in current]
    natural = np.concatenate(rows) / np.asarray(NATURAL_UNITS, np.float32)  # (T, 6)
    return torch.from_numpy(natural)[:, None].float()  # (T, 1, 6)


def _reader(encode: Encode, model: torch.nn.Module) -> Reader:
    @torch.no_grad()
    def read(reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        z = encode(reference, current, finger)
        force_N: torch.Tensor = model(z[:, None])[:, 0]  # (T, 3): each frame is a sequence of one
        return force_N[:, 2].double().numpy()

    return read
