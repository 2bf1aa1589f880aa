"""What a script sees at the end of a sweep: whether ink is left, and where it begins.

Cameras show the same to a policy, so that eyes are no privilege; scripts spare themselves the vision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lerobot_env_uniforce_wiping.env import WipeEnv

STRAY_SHARE = 0.05  # of the dirty cells: so few don't make a row the first dirty one


def look_back(env: WipeEnv) -> float | None:
    """Return the x at which the ink that is left begins, m, or None when the board counts as wiped."""
    ink = env.sim.ink
    if ink.residual <= env.limits.residual_share:
        return None
    on_board_x_m = float(np.quantile(ink.dirty_x_m, STRAY_SHARE))
    return float(env.level.layout.board_center_m[0] + env.scene.board_shift_m[0] + on_board_x_m)
