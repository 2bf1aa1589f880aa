"""Effects beside the contact model: rubber creeps (markers lag behind the force), light changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE

# of the usual light; above it the TacTip's pins clip, below noise takes over
EXPOSURE = (0.70, 1.20)
CAST = 0.15  # relative gain of single colour channels
GRADIENT = 0.25  # relative gain at the image's edge, towards a random side


@dataclass(frozen=True)
class Creep:
    """A standard linear solid: one Maxwell arm beside a spring."""

    share: float  # part of the motion that comes late, E1 / (E∞ + E1); rubbers .1–.3
    relaxation_s: float  # time constant of that part, .2–2 s

    @classmethod
    def draw(cls, rng: np.random.Generator, share: tuple[float, float]) -> Creep:
        """Return a random pad: late share even over ``share``, time even in the logarithm."""
        return cls(float(rng.uniform(*share)), float(np.exp(rng.uniform(np.log(0.2), np.log(2.0)))))


def lagging_force(force_N: np.ndarray, creep: Creep, rate_hz: float) -> np.ndarray:
    """Return the force (T, 3) whose static picture the pad shows while ``force_N`` (T, 3) acts.

    It starts relaxed. Friction's cone is kept: both parts are mixtures of forces inside it.
    """
    keep = np.exp(-1 / (creep.relaxation_s * rate_hz))
    late = np.empty_like(force_N)
    late[0] = force_N[0]
    for t in range(1, len(force_N)):
        late[t] = keep * late[t - 1] + (1 - keep) * force_N[t]
    return ((1 - creep.share) * force_N + creep.share * late).astype(force_N.dtype)


@dataclass(frozen=True)
class Light:
    """One sensor's light: a gain per channel and a linear gradient (x, y) across the image."""

    gain: tuple[float, float, float]
    gradient: tuple[float, float]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Light:
        """Return a random light."""
        gain = rng.uniform(*EXPOSURE) * (1 + rng.uniform(-CAST, CAST, 3))
        angle = rng.uniform(-np.pi, np.pi)
        slope = rng.uniform(0, GRADIENT)
        gradient = (float(slope * np.cos(angle)), float(slope * np.sin(angle)))
        return cls((float(gain[0]), float(gain[1]), float(gain[2])), gradient)

    def on(self, frames: np.ndarray) -> np.ndarray:
        """Return (B, 480, 640, 3) uint8 frames under this light."""
        lit = frames * _field(self)
        return np.clip(lit, 0, 255, out=lit).astype(np.uint8)


@lru_cache(maxsize=4)
def _field(light: Light) -> np.ndarray:
    """Return (H, W, 3) factor on each pixel."""
    rows, columns = MARKER_IMAGE_SHAPE
    x = np.linspace(-1, 1, columns, dtype=np.float32)[None] * light.gradient[0]
    y = np.linspace(-1, 1, rows, dtype=np.float32)[:, None] * light.gradient[1]
    return (1 + x + y)[..., None] * np.asarray(light.gain, np.float32)
