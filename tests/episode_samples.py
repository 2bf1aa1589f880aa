"""An episode that goes well, as a trace and as a row; tests change it."""

import numpy as np

from uniforce_vtla.evaluation.arms import EpisodeRow
from uniforce_vtla.evaluation.episode import STEP_FIELDS, EpisodeTrace

N = 120  # steps at 30 Hz


def good_trace(**changes):
    phase = np.repeat([0.0, 1.0, 2.0, 3.0], N // 4)
    zeros = np.zeros(N)
    fields = {name: zeros.copy() for name in STEP_FIELDS}
    fields |= {
        "time_s": (np.arange(N) + 1) / 30,
        "press_N": np.where(phase == 2, 6.0, 0.0),
        "grip_left_N": np.where(phase > 0, 9.0, 0.0),
        "grip_right_N": np.where(phase > 0, 9.0, 0.0),
        "residual": np.where(phase == 3, 0.05, 1.0),
        "phase": phase,
    }
    return EpisodeTrace(**(fields | changes), rated_depth_mm=(1.5, 5.0))


def good_row(seed, clean=True):
    return EpisodeRow(seed, "success", clean, False, False, 0, 0, 0, 0, 0, 0)
