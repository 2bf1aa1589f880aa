"""Other light on a camera's raw frames: exposure, colour cast, a gradient; the canonicaliser has to cope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE

EXPOSURE = (0.70, 1.20)  # of the usual light; above it the TacTip's pins clip, below noise takes over
CAST = 0.15  # relative gain of single colour channels
GRADIENT = 0.25  # relative gain at the image's edge, towards a random side


@dataclass(frozen=True)
class Light:
    """One sensor's light: a gain per channel and a linear gradient (x, y) across the image."""

    gain: tuple[float, float, float]
    gradient: tuple[float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Light:
        """Return a random light."""
        gain = rng.uniform(*EXPOSURE) * (1 + rng.uniform(-CAST, CAST, 3))
        angle, slope = rng.uniform(-np.pi, np.pi), rng.uniform(0, GRADIENT)
        gradient = (float(slope * np.cos(angle)), float(slope * np.sin(angle)))
        return cls((float(gain[0]), float(gain[1]), float(gain[2])), gradient)

    def on(self, frames: np.ndarray) -> np.ndarray:
        """Return (B, 480, 640, 3) uint8 frames under this light."""
        rows, columns = MARKER_IMAGE_SHAPE
        x = np.linspace(-1, 1, columns, dtype=np.float32)[None] * self.gradient[0]
        y = np.linspace(-1, 1, rows, dtype=np.float32)[:, None] * self.gradient[1]
        field = (1 + x + y)[..., None] * np.asarray(self.gain, np.float32)  # (H, W, 3)
        return np.clip(frames * field, 0, 255).astype(np.uint8)
