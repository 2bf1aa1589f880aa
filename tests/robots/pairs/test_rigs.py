"""Both rigs: the simulated one obeys equilibrium where it should, the robot's motion comes out of its poses."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from uniforce_robots.pairs.guided_grasp import FAULTS, GraspSettings, draw_grasp
from uniforce_robots.pairs.rehearsal import LIMIT, Rehearsal, SimulatedRig, equilibrium_error
from uniforce_robots.pairs.rig import HandMotion, RobotRig
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import ContractError


@pytest.mark.parametrize("fault", ["none", *FAULTS])
def test_only_faults_break_the_balance(fault: str) -> None:
    settings = GraspSettings(fault_share=float(fault != "none"), faults=(fault,))
    rng = np.random.default_rng(0)
    bad = []
    for _ in range(60):
        grasp = draw_grasp(rng, settings, mass_kg=0.3)
        assert grasp.fault == fault
        bad.append((equilibrium_error(grasp.left_N, grasp.right_N) > LIMIT).mean())
    assert (np.mean(bad) < 0.005) if fault == "none" else (np.mean(bad) > 0.1)


def test_what_a_pad_is_asked_for_it_can_carry() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        grasp = draw_grasp(rng, GraspSettings(), mass_kg=0.4)
        for load in (grasp.left_N, grasp.right_N):
            assert (load[:, 2] >= 0).all()
            assert (np.linalg.norm(load[:, :2], axis=1) <= 0.951 * load[:, 2] + 1e-9).all()


def test_the_simulated_rig_carries_what_was_drawn_and_repeats_by_seed() -> None:
    settings = GraspSettings(frames=16, rest_s=0.5, fault_share=0.0)
    rigs = [SimulatedRig(Rehearsal("uskin", "tactip", seed=3, grasps=settings)) for _ in range(2)]
    frames = [list(itertools.islice(rig.frames("sphere"), 20)) for rig in rigs]
    for one, other in zip(*frames, strict=True):
        assert np.array_equal(one.images["left"], other.images["left"]) and one.grasp == other.grasp
    assert [frame.grasp for frame in frames[0]] == [0] * 16 + [1] * 4
    assert rigs[0].truths[0].error.max() < LIMIT


def test_an_empty_error_is_not_divided_by_nothing() -> None:
    assert equilibrium_error(np.zeros((3, 3)), np.zeros((3, 3))).tolist() == [0, 0, 0]


@pytest.mark.parametrize("yaw", [0.0, 0.7, -np.pi / 2])
def test_motion_is_read_off_the_poses_in_the_hands_frame(yaw: float) -> None:
    motion, velocity, acceleration = HandMotion(), np.array([0.1, -0.05, 0.02]), np.array([0.5, 1.0, -0.3])
    to_base = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    for t in np.arange(10) / 30:
        position = to_base @ (velocity * t + acceleration * t**2 / 2)
        found = motion(float(t), np.array([*position, yaw, 0.02]))
    assert np.allclose(found[0], velocity + acceleration * 0.3, atol=1e-9)
    assert np.allclose(found[1], acceleration, atol=1e-6)
    with pytest.raises(ContractError, match="later"):
        motion(0.0, np.zeros(5))


def test_a_grasp_ends_once_when_the_fingers_open() -> None:
    widths = [0.06, 0.05, 0.03, 0.02, 0.0205, 0.02, 0.03, 0.045, 0.06, 0.05, 0.02, 0.03]
    ticks = itertools.count()
    steered: list[np.ndarray] = []
    image = np.zeros((480, 640, 3), np.uint8)
    poses = iter([np.array([0.5, 0, 0.2, 0, width]) for width in widths])
    robot = SimpleNamespace(measured=lambda: next(poses))
    finger = SimpleNamespace(reference_image=lambda: image, async_read=lambda: image)
    fingers, sensors = dict.fromkeys(FINGERS, finger), {"left": "gelsight", "right": "tactip"}
    settings = {"steer": steered.append, "clock": lambda: next(ticks) / 30}
    rig = RobotRig(robot, fingers, sensors, 30.0, 0.2, 6.0, **settings)
    frames = list(itertools.islice(rig.frames("sphere"), len(widths)))
    assert [frame.grasp for frame in frames] == [0] * 6 + [1] * 5 + [2]
    assert frames[0].images["left"].shape == (480, 640) and len(steered) == len(widths)
    assert {image.shape for image in rig.references().values()} == {(480, 640)}
