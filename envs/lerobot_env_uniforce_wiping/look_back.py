"""What a script sees at the end of a sweep: whether ink is left, and in which row it begins.

Cameras show the same to a policy, so that eyes are no privilege; scripts spare themselves the vision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lerobot_env_uniforce_wiping.sweep import Sweep

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv

STRAY_SHARE = 0.05  # of the dirty cells: so few don't make a row the first dirty one


def look_back(env: WipeEnv) -> float | None:
    """Return where along the sweep to begin again, m, or None when the board counts as wiped."""
    ink = env.sim.ink
    if ink.residual <= env.limits.residual_share:
        return None
    first_x_m = float(np.quantile(ink.dirty_x_m, STRAY_SHARE)) + env.scene.board_shift_m[0]
    return Sweep(env.level).row_at(env.level.layout.board_center_m[0] + first_x_m)
