from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import Table
from uniforce_vtla.tokenizer.force_head import HeadConfig, HeadTrainingConfig

SIDE = 32
PITCH_PX = {"gelsight": 8, "tactip": 10}  # two toy sensors that differ in their dots' pitch
HEAD = HeadTrainingConfig(head=HeadConfig(hidden=8, mlp=16), steps=40, batch=16)


def dots(pitch_px: float, force_N: np.ndarray) -> np.ndarray:
    """Return (S, S) uint8: dots on a grid that move with shear and grow with normal force."""
    rows, columns = np.mgrid[:SIDE, :SIDE].astype(np.float64)
    image = np.zeros((SIDE, SIDE))
    fx, fy, fz = force_N
    for y in np.arange(pitch_px / 2, SIDE, pitch_px):
        for x in np.arange(pitch_px / 2, SIDE, pitch_px):
            square = (columns - x - 0.5 * fx) ** 2 + (rows - y - 0.5 * fy) ** 2
            image = np.maximum(image, np.exp(-square / (2 * (1.2 + 0.12 * fz) ** 2)))
    return (255 * image).astype(np.uint8)


def draw_set(sensor: str, seed: int, sequences: int = 24, length: int = 4) -> LabelledSet:
    rng = np.random.default_rng(seed)
    force = rng.uniform((-3, -3, 0), (3, 3, 10), (sequences, length, 3))
    frames = np.stack([[dots(PITCH_PX[sensor], f) for f in row] for row in force])
    reference = np.repeat(dots(PITCH_PX[sensor], np.zeros(3))[None], sequences, axis=0)
    descriptor = np.zeros((sequences, length, 6), np.float32)
    return LabelledSet(reference, frames, descriptor, force.astype(np.float32), f"{sensor} {seed}")


@pytest.fixture(scope="session")
def table() -> Table:
    """Two toy sensors: training sets share their contacts, frozen sets theirs."""
    training = {sensor: draw_set(sensor, seed=1) for sensor in PITCH_PX}
    frozen = {sensor: draw_set(sensor, seed=2, sequences=8) for sensor in PITCH_PX}
    return Table(training, frozen, HEAD)


@pytest.fixture
def predictions(monkeypatch: pytest.MonkeyPatch) -> Callable[[], list[np.ndarray]]:
    """Record what rows say before it is scored; call to take what was said so far."""
    said: list[np.ndarray] = []

    def score(truth_N: np.ndarray, said_N: np.ndarray) -> dict[str, list[float]]:
        said.append(said_N)
        return {"mae_N": [float(np.abs(truth_N - said_N).mean())] * 3}

    monkeypatch.setattr("benchmarks.baselines.cells.score", score)

    def take() -> list[np.ndarray]:
        taken = list(said)
        said.clear()
        return taken

    return take
