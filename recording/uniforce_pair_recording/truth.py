"""What a pair's equilibrium error is: known in simulation only, and used there only to judge the score.

The score itself never sees it. Forces are canonical (the left finger's frame), so that in equilibrium both are equal.
"""

from __future__ import annotations

import numpy as np

from uniforce_pair_recording.pair_judge import FLOOR_N

LIMIT = 0.10  # relative error above which a pair must not be trained on


def equilibrium_error(left_N: np.ndarray, right_N: np.ndarray) -> np.ndarray:
    """Return (T,) ‖F_left − F_right‖ over the mean of both magnitudes, or over ``FLOOR_N`` where they are lighter.

    Args:
        left_N: (T, 3) force the left pad carries, canonical frame.
        right_N: (T, 3) the right pad's, canonical frame.
    """
    mean = (np.linalg.norm(left_N, axis=-1) + np.linalg.norm(right_N, axis=-1)) / 2
    return np.linalg.norm(left_N - right_N, axis=-1) / np.maximum(mean, FLOOR_N)
