"""Creep of a rubber pad: what markers show lags behind the force (one Maxwell arm beside a spring)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Creep:
    """A standard linear solid.

    Attributes:
        share: part of the motion that comes late, E1 / (E∞ + E1); rubbers .1–.3.
        relaxation_s: time constant of that part, .2–2 s.
    """

    share: float
    relaxation_s: float

    @classmethod
    def draw(cls, rng: np.random.Generator, share: tuple[float, float]) -> Creep:
        """Return a random pad: the late share even over ``share``, its time even in the logarithm."""
        return cls(float(rng.uniform(*share)), float(np.exp(rng.uniform(np.log(0.2), np.log(2.0)))))


def felt_force(force_N: np.ndarray, creep: Creep, rate_hz: float) -> np.ndarray:
    """Return the force (T, 3) whose static picture the pad shows while ``force_N`` (T, 3) acts.

    It starts relaxed at the first frame.  Friction's cone is kept: both parts are mixtures of forces inside it.
    """
    keep = np.exp(-1 / (creep.relaxation_s * rate_hz))
    late = np.empty_like(force_N)
    late[0] = force_N[0]
    for t in range(1, len(force_N)):
        late[t] = keep * late[t - 1] + (1 - keep) * force_N[t]
    return ((1 - creep.share) * force_N + creep.share * late).astype(force_N.dtype)
