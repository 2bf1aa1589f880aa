"""Events from finger forces and ink from a camera: made-up ones whose answer is known, and the
simulator's truth."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.cameras import front_camera
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.expert import ExpertTouch
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.evaluation.board_camera import estimate_residual
from uniforce_vtla.evaluation.episode import WIPING_PHASE, ScoreLimits, press_events, score_episode
from uniforce_vtla.evaluation.finger_estimates import estimate_events

RATE = 30
WEIGHT_N = 0.8
FRICTION = (0.6, 0.8)


def wipe(press_N, grip_N=9.0, bias_N=0.0):
    """Grasp, lift, carry for a second, press for three: time, forces, height."""
    time_s = np.arange(6 * RATE) / RATE
    height = np.interp(time_s, [1, 2], [0.1, 0.2])
    press = np.where(time_s > 3, press_N, 0.0)
    up = (WEIGHT_N - press) / 2 * (time_s > 1)
    grip = np.where(time_s > 0.5, grip_N, 0.0)
    finger = np.column_stack([0 * up, up + bias_N, grip])
    along = np.interp(time_s, [3, 6], [0.0, 0.3])  # 100 mm/s
    return time_s, np.stack([finger] * 2, axis=1), np.column_stack([0 * along, along, height])


@given(st.floats(0.5, 14.0), st.floats(-1.0, 1.0))
def test_the_board_bears_what_the_pads_no_longer_do(press_N, bias_N):
    time_s, force, height = wipe(press_N, grip_N=20.0, bias_N=bias_N)
    found = estimate_events(time_s, force, height, FRICTION)
    assert found.press_N[time_s > 3.1] == pytest.approx(press_N, abs=1e-6)
    assert found.press_N[time_s < 1] == pytest.approx(0.0)
    assert bool(found.excess_force) == (press_N > ScoreLimits().mean_press_N)
    assert not found.slippage and not found.lost
    assert found.in_band_share == pytest.approx(float(4 <= press_N <= 8), abs=0.02)


def test_both_pads_at_their_limit_slide_one_alone_does_not():
    time_s, force, height = wipe(9.0, grip_N=6.0)  # shear 4.1 of 3.6 N and 4.8 N
    one = estimate_events(time_s, force, height, FRICTION)
    assert one.friction_used[-1, 0] > 0.9 > one.friction_used[-1, 1] and not one.slippage
    both = estimate_events(time_s, force, height, (0.6, 0.6))
    assert "friction limit" in both.slippage[0]


def test_an_empty_hand_is_lost_or_never_lifted():
    time_s, force, height = wipe(5.0)
    assert estimate_events(time_s, 0 * force, height, FRICTION).lost == ("never lifted",)
    force[time_s > 4] = 0.0
    assert "no grip" in estimate_events(time_s, force, height, FRICTION).lost[0]


def test_what_cannot_be_judged_is_refused():
    time_s, force, height = wipe(5.0)
    with pytest.raises(ContractError, match="Align them"):
        estimate_events(time_s, force[:-1], height, FRICTION)
    with pytest.raises(ContractError, match="pull slowly"):
        estimate_events(time_s, force, height, (0.0, 0.6))
    with pytest.raises(ContractError, match="Sort them"):
        estimate_events(time_s[::-1], force, height, FRICTION)
    with pytest.raises(ContractError, match="finite"):
        estimate_events(time_s, force * np.nan, height, FRICTION)
    short = slice(0, int(1.4 * RATE))  # just lifted when the recording ends
    with pytest.raises(DatasetError, match="free air first"):
        estimate_events(time_s[short], force[short], height[short], FRICTION)


@pytest.mark.parametrize(
    "press_N, grip_N, seed",
    [(6.8, 4.0, 30_006), (9.5, 9.0, 30_001), (11.5, 9.0, 30_001), (7.5, 9.0, 30_005)],
)
def test_true_forces_tell_the_simulators_events(press_N, grip_N, seed):
    """A hand too loose, too slippery a handle, too firm a press, and a clean wipe."""
    # the servo, since a hand that holds by its own force doesn't grip as loosely as is asked
    env = WipeEnv("touch", drawn=(), gripper="servo")
    expert = WipeExpert(settings=ExpertTouch(press_N, grip_N))
    force, place = [], []
    for _ in walk(env, expert, seed):
        wrench = env.true_wrench()
        force.append([wrench[finger][:3] for finger in FINGERS])
        place.append(env.state[:3])
    trace, truth = env.trace, score_episode(env.trace)
    felt = np.array(force, float), np.array(place, float)
    found = estimate_events(trace.time_s, *felt, env.scene.pad_friction)
    assert bool(found.slippage) == truth.slippage
    pressed_hard = press_events(trace.press_N, trace.time_s, ScoreLimits())
    assert bool(found.excess_force) == bool(pressed_hard)
    wiping = (trace.phase == WIPING_PHASE) & (trace.slip_mm < 5)
    assert abs(found.in_band_share - truth.metrics["in_band_share"]) < 0.1
    # the hand is pulled meanwhile
    assert np.abs(found.press_N - trace.press_N)[wiping].mean() < 0.2


CORNERS = np.array([[20, 30], [300, 40], [310, 200], [10, 190]])


def board(word_left=1.0, light=1.0, hidden=False):
    """A white board with a bar of ink, part of it wiped, maybe an arm over it."""
    image = np.full((240, 320, 3), 90, np.uint8)
    cv2.fillConvexPoly(image, CORNERS, (225, 228, 224))
    image[100:130, 80 : 80 + round(160 * word_left)] = (30, 30, 120)
    if hidden:
        image[60:160, 70:200] = (60, 60, 66)
    return np.clip(image * light, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("left", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("light", [1.0, 0.93])
def test_what_is_left_is_counted_also_when_the_light_changed(left, light):
    found = estimate_residual(board(), board(left, light), CORNERS)
    assert found.residual == pytest.approx(left, abs=0.05) and found.judged > 0.9


def test_hidden_ink_is_not_guessed():
    with pytest.raises(DatasetError, match="Move the arm away"):
        estimate_residual(board(), board(0.5, hidden=True), CORNERS)


def test_an_empty_board_and_wrong_corners_are_refused():
    with pytest.raises(DatasetError, match="before the wipe"):
        estimate_residual(board(0.0), board(0.0), CORNERS)
    with pytest.raises(ContractError, match="order around"):
        estimate_residual(board(), board(), CORNERS[[0, 2, 1, 3]])
    with pytest.raises(ContractError, match="one camera"):
        estimate_residual(board(), board()[:100], CORNERS)


def corners_of(env):
    """The simulated board's corners in the front camera, as a person would click them."""
    sim = env.sim
    geom = sim.model.geom("board")
    half = sim.model.geom_size[geom.id]
    local = np.array([[-1, -1, 1], [-1, 1, 1], [1, 1, 1], [1, -1, 1]]) * half
    world = local @ sim.data.geom_xmat[geom.id].reshape(3, 3).T + sim.data.geom_xpos[geom.id]
    camera = front_camera(sim.scene)
    return camera.to_pixels(camera.to_camera(world))


@pytest.mark.parametrize("seed, stop_at", [(1, 0.85), (2, 0.4), (5, 0.0)])
def test_the_estimate_is_near_the_simulators_truth(seed, stop_at):
    """Wipe until so much is left, let the arm go home, and look."""
    env = WipeEnv("touch", drawn=())
    first = env.reset(seed=seed)[0]["pixels"]["front"]
    home = env.sim.measured.copy()
    for _ in walk(env, WipeExpert(), seed):
        if env.sim.ink.residual <= stop_at:
            break
    up = env.sim.measured + np.array([0, 0, 0.08, 0, 0])
    for target in (up, np.r_[home[:2], up[2:]]):  # up, then back over the tray
        for _ in range(60):
            env.advance(target)
    found = estimate_residual(first, env.observe()["pixels"]["front"], corners_of(env))
    assert found.judged > 0.7
    assert found.residual == pytest.approx(env.sim.ink.residual, abs=0.08)
