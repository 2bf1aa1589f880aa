"""Pad images of the scene where contact truth and geometry disagree for a moment."""

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv
from lerobot_env_uniforce_wiping.expert import WipeExpert
from uniforce_vtla.contracts import FINGERS, Finger
from uniforce_vtla.keys import tactile_name


@pytest.mark.parametrize("finger", FINGERS)
def test_an_eraser_lost_within_a_step_leaves_the_pad_in_free_air(finger: Finger) -> None:
    """The wrench is the step's mean, the geometry its end: the last newtons of a slide meet an empty pad."""
    env = WipeEnv("touch", "gelsight", "tactip")
    env.reset(seed=3)  # the eraser stands in its tray, the pads face nothing
    free = env.observe()["pixels"][tactile_name(finger)]
    env.sim.pads[finger].wrench[:] = (0.4, -0.8, 1.5, 3.0)
    touched = env.observe()["pixels"][tactile_name(finger)]
    assert np.mean(free != touched) < 0.01  # noise, no contact


def test_rigs_differ_in_the_left_fingers_marker_image_alone() -> None:
    """The benchmark rolls such arms out on one rig only."""
    rigs = [WipeEnv("touch", left, "tactip") for left in ("gelsight", "uskin")]
    for env in rigs:
        env.reset(seed=5)
    expert = WipeExpert()
    expert.reset(rigs[0])
    while min(rigs[0].true_wrench()[finger][2] for finger in FINGERS) < 3:  # until it holds the eraser
        action = expert.act(rigs[0])
        for env in rigs:
            env.advance(action)
    seen = [env.observe() for env in rigs]
    for key in ("front", "wrist", "tactile_right"):
        np.testing.assert_array_equal(seen[0]["pixels"][key], seen[1]["pixels"][key])
    np.testing.assert_array_equal(seen[0]["agent_pos"], seen[1]["agent_pos"])
    assert (seen[0]["pixels"]["tactile_left"] != seen[1]["pixels"]["tactile_left"]).any()
