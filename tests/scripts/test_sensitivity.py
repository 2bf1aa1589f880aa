"""The probe tells a controller that listens to touch from one that doesn't."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.sensitivity import Look, measure
from uniforce_vtla.keys import CAMERAS, tactile_name


class Listener:
    """Its chunk is the brightness of the streams it listens to, and a little noise."""

    needs_true_wrench = False
    config = SimpleNamespace(action=SimpleNamespace(delta_scale=[1.0] * 5), chunk_size=4, max_action_dim=8)

    def __init__(self, *streams: str) -> None:
        self.streams = streams

    def reset(self, env: object) -> None:
        pass

    def predict(self, observation: dict[str, Any], task: str, noise: torch.Tensor) -> np.ndarray:
        heard = sum(float(observation["pixels"][name].mean()) for name in self.streams)
        return np.full((4, 5), heard) + 0.01 * noise[0, :, :5].numpy()


def moment(contact: bool, seed: int) -> Look:
    rng = np.random.default_rng(seed)
    pixels = {name: rng.random((4, 4, 3)) + 1 for name in CAMERAS}
    for finger in ("left", "right"):
        free = rng.random((4, 4, 3))
        pixels[tactile_name(finger, reference=True)] = free
        pixels[tactile_name(finger)] = free + (0.5 * rng.random() + 0.5 if contact else 0.0)
    return Look({"pixels": pixels}, "wipe", contact)


@pytest.mark.parametrize(
    ("heard", "moves"),
    [
        (tactile_name("left"), {"touch as in free air", "touch of another moment"}),
        ("front", {"front camera black"}),
        ("wrist", {"wrist camera black"}),
    ],
)
def test_only_what_is_listened_to_moves_the_chunk(heard: str, moves: set[str]) -> None:
    found = measure(Listener(heard), [moment(i % 2 == 0, i) for i in range(12)])  # type: ignore[arg-type]
    noise = found.pop("other noise")
    assert 0 < noise["contact"] < 0.02
    for name, change in found.items():
        assert (change["contact"] > 5 * noise["contact"]) == (name in moves)
    if "touch as in free air" in moves:
        assert found["touch as in free air"]["no contact"] == pytest.approx(0.0)
