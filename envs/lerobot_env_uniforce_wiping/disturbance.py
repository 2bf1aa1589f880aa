"""A hand that gets nudged while it demonstrates, so that demos hold recoveries.

The executed target is the expert's target plus a slow offset that nobody is told of.  The expert feels its effect and
corrects; the dataset stores what the expert *commanded*, so every label is a correction and never the nudge itself
(the idea of DART: Laskey et al. 2017, "Noise Injection for Robust Imitation Learning").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.simulation import CONTROL_HZ


@dataclass(frozen=True)
class NudgeSettings:
    """Spread of the offset per axis; an offset in z or width is a force through the arm's or gripper's stiffness."""

    sd: tuple[float, float, float, float, float] = (0.0012, 0.0012, 0.0022, 0.010, 0.0004)  # m, m, m, rad, m
    # 2.2 mm · 800 N/m ≈ 1.8 N: presses of 10 N and more occur, and are corrected within half a second
    correlation_s: float = 0.6  # about the time the expert needs to correct a press


class Nudge:
    """Ornstein-Uhlenbeck offset of the executed target.

    Args:
        seed: the scene's; an episode repeats exactly.
        scale: 0 = none, 1 = as set.
        settings: spread and correlation time.
    """

    def __init__(self, seed: int, scale: float = 1.0, settings: NudgeSettings | None = None) -> None:
        settings = settings or NudgeSettings()
        self._rng = np.random.default_rng([seed, 777])
        self._sd = scale * np.array(settings.sd)
        self._keep = float(np.exp(-1 / (settings.correlation_s * CONTROL_HZ)))
        self.offset = np.zeros(len(self._sd))

    def apply(self, target: np.ndarray) -> np.ndarray:
        """Return the (5,) float32 target the arm is really sent to, one step later each call."""
        kick = np.sqrt(1 - self._keep**2) * self._sd * self._rng.standard_normal(len(self._sd))
        self.offset = self._keep * self.offset + kick
        return (target + self.offset).astype(np.float32)
