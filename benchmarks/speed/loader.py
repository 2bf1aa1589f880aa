"""How fast demos reach the trainer: stock LeRobot and the training view on the same data, in the same run."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from torch.utils.data import DataLoader, Dataset, RandomSampler

from benchmarks.timing import repeated
from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.synthetic import FPS, record_synthetic
from uniforce_datasets.training_view import TrainingView, build_view
from uniforce_vtla.contracts import Finger

CHUNK = 16  # actions per sample, as the tiny policy
BATCH = 8
EPISODES, FRAMES = 3, 90  # of the synthetic data: 9 s, so that random access is real


class BlockMeans:
    """Stands in for the tokenizer: the loader's speed depends on the latents' size only."""

    hash = "block means"

    def __call__(self, reference: np.ndarray, current: np.ndarray, finger: Finger) -> np.ndarray:
        """Return (B, 96): as many numbers as 4×4 pooled latents of 6."""
        change = (current != reference).reshape(len(current), 96, -1)
        return change.mean(axis=2, dtype=np.float32)


def bench_loader(seconds: float) -> dict[str, Any]:
    """Return samples per second of one process on synthetic data, shuffled and batched, with a 16-step action chunk."""
    with tempfile.TemporaryDirectory() as folder:
        data = record_synthetic(Path(folder) / "data", EPISODES, FRAMES)
        view = build_view(data, Path(folder) / "view", encoder=BlockMeans(), keep=lambda facts: True)
        chunk = {"action": [step / FPS for step in range(CHUNK)]}
        stock = open_dataset(data, delta_timestamps=chunk, return_uint8=True)
        return {
            "stock_samples_per_s": _rate(stock, seconds),
            "view_samples_per_s": _rate(TrainingView(view, range(CHUNK)), seconds),
        }


def _rate(dataset: Dataset, seconds: float) -> float:
    """Samples per second through a DataLoader, its first batch left out."""
    loader = DataLoader(dataset, batch_size=BATCH, sampler=RandomSampler(dataset, replacement=True, num_samples=10**6))
    batches = iter(loader)
    calls, spent = repeated(lambda: next(batches), seconds)
    return BATCH * calls / spent
