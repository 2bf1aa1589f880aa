"""Force on one pad from its touch field: a small network per kind of sensor, trained in simulation on many units.

It reads marker motion, not the tokenizer's latents, because a tenth of the force must be distinguished: on simulated
grasps of units it has not seen its shear is off by less than 0.1 N, where heads on latents are off by a sixth of the
force. Its normal force leans on the shape of what is held and is corrected per grasp (see ``pair_judge``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import nn

from uniforce_robots.pairs.touch_field import FEATURES
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.tokenizer.weights import load_model, read_config

ASSETS = Path(__file__).parent / "assets"
HIDDEN = (192, 96)


class FingerForce(nn.Module):
    """(N, 192) touch fields → (N, 3) newtons, canonical frame."""

    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, dropout: float = 0.0) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(FEATURES))
        self.register_buffer("spread", torch.ones(FEATURES))
        first, second = HIDDEN
        self.layers = nn.Sequential(
            nn.Dropout(dropout), nn.Linear(FEATURES, first), nn.GELU(), nn.Linear(first, second), nn.GELU(),
            nn.Linear(second, 3),
        )  # fmt: skip

    def forward(self, field: torch.Tensor) -> torch.Tensor:
        """Return (N, 3) N of (N, 192) fields."""
        return self.layers((field - self.mean) / self.spread)

    @torch.no_grad()
    def read(self, field: np.ndarray) -> np.ndarray:
        """Return (N, 3) float64 N of (N, 192) fields."""
        return self(torch.from_numpy(np.asarray(field, np.float32))).double().numpy()

    @classmethod
    def from_pretrained(cls, sensor: str, folder: str | Path | None = None) -> FingerForce:
        """Load the reader of a kind of sensor, shipped or from a folder.

        Raises:
            CheckpointError: none for that sensor, or damaged.
        """
        path = Path(folder) if folder else ASSETS / sensor
        if not path.is_dir():
            known = " | ".join(sorted(p.name for p in ASSETS.glob("*") if p.is_dir()))
            do = "Train one: python -m benchmarks.pair_quality train=true rigs=…"
            raise CheckpointError(expected(f"force reader of {sensor}", known, "none", do))
        facts = read_config(path)
        if facts.get("sensor") != sensor:
            raise CheckpointError(
                expected(str(path), f"a reader of {sensor}", facts.get("sensor"), "Name another.")
            )
        return load_model(path, cls).eval()
