"""Pad images of the scene where contact truth and geometry disagree for a moment."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.episodes import walk
from uniforce_vtla.contact.units import UnitVariation
from uniforce_vtla.contact.virtual import any_virtual, as_virtual
from uniforce_vtla.contact.wear import Creep
from uniforce_vtla.contact.worn import drawing
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.keys import tactile_name
from uniforce_vtla.tokenizer import ForceHead, Tokenizer


@pytest.mark.parametrize("finger", FINGERS)
def test_an_eraser_lost_within_a_step_leaves_the_pad_in_free_air(finger):
    """The wrench is the step's mean, the geometry its end: a slide may end on an empty pad."""
    env = WipeEnv("touch", "gelsight:drawing", "tactip:drawing")
    env.reset(seed=3)  # the eraser stands in its tray, the pads face nothing
    free = env.observe()["pixels"][tactile_name(finger)]
    env.sim.pads[finger].wrench[:] = (0.4, -0.8, 1.5, 3.0)
    for _ in range(3):
        env._touch[finger].follow(env.sim)
    touched = env.observe()["pixels"][tactile_name(finger)]
    assert np.mean(free != touched) < 0.01  # noise, no contact


def test_rigs_differ_in_the_left_fingers_marker_image_alone():
    """The benchmark rolls such arms out on one rig only."""
    rigs = [WipeEnv("touch", f"{left}:drawing", "tactip:drawing") for left in ("gelsight", "uskin")]
    rigs[1].start(5)
    for action in walk(rigs[0], WipeExpert(), 5):
        rigs[1].advance(action)
        if min(rigs[0].true_wrench()[finger][2] for finger in FINGERS) >= 3:
            break  # it holds the eraser
    one, other = (env.observe() for env in rigs)
    for key in ("front", "wrist", "tactile_right"):
        np.testing.assert_array_equal(one["pixels"][key], other["pixels"][key])
    np.testing.assert_array_equal(one["agent_pos"], other["agent_pos"])
    assert (one["pixels"]["tactile_left"] != other["pixels"]["tactile_left"]).any()


def held(left, **options):
    """Return a scene whose expert has held the eraser for half a second."""
    env = WipeEnv("touch", left, "tactip:drawing", **options)
    steps = 0
    for _ in walk(env, WipeExpert(), 5):
        steps += env.true_wrench()["left"][2] > 6
        if steps == 15:
            return env


def read(env):
    """Return the left finger's own reading, (3,) N, mean of several noisy images of one moment."""
    reference, current = np.swapaxes([env.marker_pair("left") for _ in range(8)], 0, 1)
    latent = Tokenizer.from_pretrained().encode(reference, current, "left")
    return ForceHead.from_pretrained(env.sensors["left"])(latent).numpy().mean(axis=0)


@pytest.mark.parametrize("kind, grip_N", [("gelsight", 1.0), ("tactip", 0.5), ("uskin", 0.3)])
def test_raw_frames_and_canonicalizer_read_as_the_direct_drawing_does(kind, grip_N):
    """The fast path gives the same; a flat gel under a face that covers it moves by .2 px."""
    plain = drawing(as_virtual(kind))
    fast = read(held(plain))
    raw = read(held(replace(plain, direct=False)))
    assert abs(fast[2] - raw[2]) < grip_N and np.abs(fast[:2] - raw[:2]).max() < 0.3


def test_a_stiff_unit_has_a_stiff_pad_and_a_picture_that_moves_less():
    plain = drawing(as_virtual("tactip"))
    stiff = replace(plain, unit=UnitVariation(stiffness=1.5))
    K = []
    for worn in (plain, stiff):
        env = WipeEnv("touch", worn, drawn=())
        env.start(5)
        K.append(env.sim.model.geom_solref[env.sim.model.geom("pad_left").id, 0])
    assert K[1] == pytest.approx(1.5 * K[0])
    assert stiff.stiffness == 1.5
    assert drawing(any_virtual("gelsight_stiff")).stiffness == pytest.approx(1.6)


def test_a_picture_is_late_by_a_step_and_rubber_lags_behind():
    creep = Creep(share=0.2, relaxation_s=0.5)
    worn = replace(drawing(as_virtual("tactip")), lag_steps=1, creep=creep)
    env = WipeEnv("touch", "gelsight:drawing", worn)
    env.start(5)
    pad = env._touch["right"]
    shown = []
    for _ in range(60):
        env.sim.pads["right"].wrench[:] = (0.0, 0.0, 5.0, 0.0)
        pad.follow(env.sim)
        shown.append(pad._past[0].wrench[2])
    # a step late, then 80 % at once
    assert shown[0] == 0 and shown[1] == pytest.approx(4.0, abs=0.1)
    assert np.all(np.diff(shown[1:]) > 0) and shown[-1] == pytest.approx(5.0, abs=0.05)


def test_a_pad_that_nobody_reads_is_not_drawn():
    env = held("gelsight:drawing", drawn=("right",))
    assert set(env.observe()["pixels"]) == {"front", "wrist", "tactile_right", "tactile_right_ref"}
    assert "tactile_left" not in env.observation_space["pixels"].spaces
