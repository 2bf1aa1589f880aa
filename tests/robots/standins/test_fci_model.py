"""The stand-in's kinematics and dynamics, without sockets: in the robot's own milliseconds."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad, Q_MAX_rad, Q_MIN_rad, TAU_MAX_Nm, posture
from uniforce_robots.standins.fci.arm import Arm, TORQUE_STEP_Nm, Wall, broken_rules
from uniforce_robots.standins.fci.arm_service import urdf
from uniforce_robots.standins.fci.protocol import ErrorBit


def test_home_is_where_the_manual_shows_it() -> None:
    hand = posture(HOME_q_rad).flange_to_base @ HAND_TO_FLANGE
    np.testing.assert_allclose(hand[:3, :3], np.diag([1, -1, -1]), atol=1e-12)
    np.testing.assert_allclose(hand[:3, 3], [0.3069, 0, 0.4869], atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_is_the_derivative_of_the_pose(seed: int) -> None:
    q = np.random.default_rng(seed).uniform(Q_MIN_rad, Q_MAX_rad)
    here = posture(q).flange_to_base
    J = posture(q).jacobian(here[:3, 3])
    for i in range(7):
        step = np.zeros(7)
        step[i] = 1e-6
        there = posture(q + step).flange_to_base
        turn = (there[:3, :3] @ here[:3, :3].T - np.eye(3)) / 1e-6
        np.testing.assert_allclose(J[:3, i], (there[:3, 3] - here[:3, 3]) / 1e-6, atol=1e-5)
        np.testing.assert_allclose(J[3:, i], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-5)


def test_the_model_has_the_names_a_client_asks_for() -> None:
    robot = ET.fromstring(urdf())
    assert [link.get("name") for link in robot.iter("link")] == [f"link{i}" for i in range(9)]
    for joint in [j for j in robot.iter("joint") if j.get("type") == "revolute"]:
        limits = joint.find("position_based_velocity_limits")
        assert joint.find("limit") is not None and limits is not None
        assert {"velocity_offset", "deceleration_limit"} <= set(limits.keys())


def spring(arm: Arm, goal_m: np.ndarray, stiffness: float) -> np.ndarray:
    twist = arm.jacobian @ arm.dq_rad_s
    error = np.concatenate([goal_m - arm.ee_to_base[:3, 3], np.zeros(3)])
    force = stiffness * error - np.array([90.0] * 3 + [10.0] * 3) * twist
    return arm.jacobian.T @ force


def test_pressing_on_the_wall_gives_stiffness_times_depth() -> None:
    arm = Arm(wall=Wall(height_m=0.47, stiffness_N_m=50000.0))
    goal = arm.ee_to_base[:3, 3] * [1, 1, 0] + [0, 0, 0.46]
    for _ in range(2500):
        arm.drive(spring(arm, goal, 800.0))
    assert arm.contact_N[2] == pytest.approx(800 * 0.01, rel=0.05)


def test_a_brake_stops_the_arm_within_a_tenth_of_a_second() -> None:
    arm = Arm(dq_rad_s=np.full(7, 0.1))
    for _ in range(100):
        arm.hold()
    assert np.abs(arm.dq_rad_s).max() < 1e-4


@pytest.mark.parametrize("share", [1.0, -1.0, 1.1, -1.1])
def test_a_torque_at_the_limit_is_followed_and_one_beyond_it_is_named(share: float) -> None:
    beyond = abs(share) > 1
    step, strong = np.full(7, share * TORQUE_STEP_Nm), share * TAU_MAX_Nm
    assert broken_rules(step) == ({ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY} if beyond else set())
    assert broken_rules(5 + step, np.full(7, 5.0)) == broken_rules(step)
    assert broken_rules(strong, strong) == ({ErrorBit.TAU_J_RANGE_VIOLATION} if beyond else set())


def test_what_goes_beyond_a_threshold_is_named() -> None:
    arm = Arm(wrench_N=np.array([0, 0, 31.0, 0, 0, 0]))
    assert ErrorBit.CARTESIAN_REFLEX in arm.violations()
    arm = Arm(q_rad=Q_MAX_rad + 0.01)
    assert ErrorBit.JOINT_POSITION_LIMITS_VIOLATION in arm.violations()
    arm = Arm(dq_rad_s=np.full(7, 6.0))
    assert ErrorBit.JOINT_VELOCITY_VIOLATION in arm.violations()
    assert not Arm().violations()
