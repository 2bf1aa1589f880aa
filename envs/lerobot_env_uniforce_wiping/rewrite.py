"""Ink that comes back behind the eraser, so that demonstrations show how to go back to it."""

from dataclasses import dataclass

import numpy as np

from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ


@dataclass(frozen=True)
class RewriteSettings:
    """When ink comes back to the board, and how much."""

    share: float = 0.7  # of the episodes; ink that the eraser still passes is wiped unnoticed
    after_s: tuple[float, float] = (3.5, 5.8)  # of wiping; the sweep takes six
    height_m: tuple[float, float] = (0.020, 0.040)  # along board x, of a writing 34 to 48 mm high
    length_m: tuple[float, float] = (0.030, 0.080)  # along board y, of a writing 70 to 100 mm long
    # of the first ink: faint as a light stroke leaves it, or dark
    strength: tuple[float, float] = (0.4, 1.0)


class Rewrite:
    """Bring part of the writing back in some episodes, for the expert to find when it looks back.

    Without it demos end with the first sweep, and a policy whose first sweep was too light stops
    after it.

    Args:
        seed: the scene's; an episode repeats exactly.
        settings: when and how much.
    """

    def __init__(self, seed: int, settings: RewriteSettings | None = None) -> None:
        s = settings or RewriteSettings()
        rng = np.random.default_rng([seed, 779])
        self._left_s = np.inf
        if rng.random() < s.share:
            self._left_s = float(rng.uniform(*s.after_s))
        self._size_m = np.array([rng.uniform(*s.height_m), rng.uniform(*s.length_m)])
        self._place = rng.uniform(-0.3, 0.3, 2)  # of the whole writing's box
        self._strength = float(rng.uniform(*s.strength))

    def apply(self, ink: InkField, wiping: bool) -> None:
        """Write when its time has come; call once per step."""
        self._left_s -= wiping / CONTROL_HZ
        if self._left_s <= 0:
            self._left_s = np.inf
            center_m, extent_m = ink.written_box_m
            ink.rewrite(center_m + self._place * extent_m, self._size_m, self._strength)
