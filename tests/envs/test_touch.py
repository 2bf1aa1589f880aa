"""Pad images of the scene where contact truth and geometry disagree for a moment."""

from __future__ import annotations

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.keys import tactile_name


@pytest.mark.parametrize("finger", FINGERS)
def test_an_eraser_lost_within_a_step_leaves_the_pad_in_free_air(finger: Finger) -> None:
    """The wrench is the step's mean, the geometry its end: the last newtons of a slide meet an empty pad."""
    env = WipeEnv("paper", "gelsight", "tactip")
    env.reset(seed=3)  # the eraser stands in its tray, the pads face nothing
    free = env.observe()["pixels"][tactile_name(finger)]
    env.sim.pads[finger].wrench[:] = (0.4, -0.8, 1.5, 3.0)
    touched = env.observe()["pixels"][tactile_name(finger)]
    assert np.mean(free != touched) < 0.01  # noise, no contact
