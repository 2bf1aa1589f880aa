"""The project's axes against the hand's pose and the stiffness in the base frame."""

import numpy as np
import pytest

from uniforce_robots.fr3 import HAND_TO_FLANGE, HOME_q_rad, posture
from uniforce_robots.franka.arm import HAND_GUIDED, Gains
from uniforce_robots.franka.poses import ToolPose, between, shortest_turn
from uniforce_vtla.errors import ContractError


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.7, 3.1])
def test_a_pose_comes_back(yaw: float) -> None:
    pose = ToolPose(np.array([0.4, -0.1, 0.2]), yaw)
    again = ToolPose.from_ee(pose.ee_to_base())
    np.testing.assert_allclose(again.position_m, pose.position_m)
    assert again.yaw_rad == pytest.approx(yaw)
    R = pose.ee_to_base()[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1) and R[2, 2] == pytest.approx(-1), "the tool points down"
    np.testing.assert_allclose(R[:, 1], [np.cos(yaw), np.sin(yaw), 0], atol=1e-12)  # the fingers close along y


def test_yaw_of_the_arms_home_is_a_quarter_turn_and_zero_lies_within_joint_7() -> None:
    home = posture(HOME_q_rad).flange_to_base @ HAND_TO_FLANGE
    assert ToolPose.from_ee(home).yaw_rad == pytest.approx(-np.pi / 2)
    q = HOME_q_rad - np.array([0, 0, 0, 0, 0, 0, np.pi / 2])
    assert ToolPose.from_ee(posture(q).flange_to_base @ HAND_TO_FLANGE).yaw_rad == pytest.approx(0, abs=1e-9)


def test_turns_take_the_shorter_way() -> None:
    assert shortest_turn(3.0, -3.0) == pytest.approx(2 * np.pi - 6)
    assert shortest_turn(0.1, 0.4) == pytest.approx(0.3)
    half = between(ToolPose(np.zeros(3), 3.1), ToolPose(np.ones(3), -3.1), 0.5)
    assert abs(half.yaw_rad) == pytest.approx(np.pi) and half.position_m[0] == 0.5


@pytest.mark.parametrize("yaw", [0.0, 0.6, np.pi / 2])
def test_the_closing_axis_is_the_stiff_one_however_the_hand_is_turned(yaw: float) -> None:
    R = ToolPose(np.zeros(3), yaw).ee_to_base()[:3, :3]
    K = HAND_GUIDED.matrix_in_base(R)
    closing = R[:, 1]
    np.testing.assert_allclose(K[:3, :3] @ closing, 2000 * closing, atol=1e-9)
    across = np.array([-closing[1], closing[0], 0])
    np.testing.assert_allclose(K[:3, :3] @ across, 200 * across, atol=1e-9)
    np.testing.assert_allclose(K, K.T, atol=1e-9)
    assert not K[:3, 3:].any()


def test_gains_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ContractError, match="from 0 to 3000"):
        Gains((-1.0, 0.0, 0.0))
