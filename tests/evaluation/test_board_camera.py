"""The camera's estimate of ink left, against the simulator's truth and on made-up boards."""

import cv2
import numpy as np
import pytest

from lerobot_env_uniforce_wiping import WipeEnv, WipeExpert
from lerobot_env_uniforce_wiping.cameras import front_camera
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.evaluation.board_camera import estimate_residual

CORNERS = np.array([[20, 30], [300, 40], [310, 200], [10, 190]])


def board(word_left: float = 1.0, light: float = 1.0, hidden: bool = False) -> np.ndarray:
    """A white board with a bar of ink, part of it wiped, maybe an arm over it."""
    image = np.full((240, 320, 3), 90, np.uint8)
    cv2.fillConvexPoly(image, CORNERS, (225, 228, 224))
    image[100:130, 80 : 80 + round(160 * word_left)] = (30, 30, 120)
    if hidden:
        image[60:160, 70:200] = (60, 60, 66)
    return np.clip(image * light, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("left", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("light", [1.0, 0.93])
def test_what_is_left_is_counted_also_when_the_light_changed(left: float, light: float) -> None:
    found = estimate_residual(board(), board(left, light), CORNERS)
    assert found.residual == pytest.approx(left, abs=0.05) and found.judged > 0.9


def test_hidden_ink_is_not_guessed() -> None:
    with pytest.raises(DatasetError, match="Move the arm away"):
        estimate_residual(board(), board(0.5, hidden=True), CORNERS)


def test_an_empty_board_and_wrong_corners_are_refused() -> None:
    with pytest.raises(DatasetError, match="before the wipe"):
        estimate_residual(board(0.0), board(0.0), CORNERS)
    with pytest.raises(ContractError, match="order around"):
        estimate_residual(board(), board(), CORNERS[[0, 2, 1, 3]])
    with pytest.raises(ContractError, match="one camera"):
        estimate_residual(board(), board()[:100], CORNERS)


def corners_of(env: WipeEnv) -> np.ndarray:
    """The simulated board's corners in the front camera, as a person would click them."""
    sim = env.sim
    geom = sim.model.geom("board")
    half = sim.model.geom_size[geom.id]
    local = np.array([[-1, -1, 1], [-1, 1, 1], [1, 1, 1], [1, -1, 1]]) * half
    world = local @ sim.data.geom_xmat[geom.id].reshape(3, 3).T + sim.data.geom_xpos[geom.id]
    camera = front_camera(sim.scene)
    return camera.to_pixels(camera.to_camera(world))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "stop_at"), [(1, 0.85), (2, 0.4), (5, 0.0)])
def test_the_estimate_is_near_the_simulators_truth(seed: int, stop_at: float) -> None:
    """Wipe until so much is left, let the arm go home, and look."""
    env, expert = WipeEnv("paper"), WipeExpert()
    first = env.reset(seed=seed)[0]["pixels"]["front"]
    expert.reset(env)
    home, done = env.sim.measured.copy(), False
    while not done and env.sim.ink.residual > stop_at:
        done = env.advance(expert.act(env))
    up = env.sim.measured + np.array([0, 0, 0.08, 0, 0])
    for target in (up, np.r_[home[:2], up[2:]]):  # up, then back over the tray
        for _ in range(60):
            env.advance(target)
    truth = env.sim.ink.residual
    found = estimate_residual(first, env.observe()["pixels"]["front"], corners_of(env))
    assert found.judged > 0.7
    assert found.residual == pytest.approx(truth, abs=0.08)
