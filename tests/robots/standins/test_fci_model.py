"""The stand-in's kinematics and dynamics, without sockets: in the robot's own milliseconds."""

import numpy as np
import pytest

from uniforce_robots.fr3 import (
    HAND_TO_FLANGE,
    HOME_q_rad,
    Q_MAX_rad,
    Q_MIN_rad,
    TAU_MAX_Nm,
    posture,
)
from uniforce_robots.standins.fci.arm import TORQUE_STEP_Nm, broken_rules
from uniforce_robots.standins.fci.protocol import ErrorBit


def test_home_is_where_the_manual_shows_it():
    hand = posture(HOME_q_rad).flange_to_base @ HAND_TO_FLANGE
    np.testing.assert_allclose(hand[:3, :3], np.diag([1, -1, -1]), atol=1e-12)
    np.testing.assert_allclose(hand[:3, 3], [0.3069, 0, 0.4869], atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_jacobian_is_the_derivative_of_the_pose(seed):
    q = np.random.default_rng(seed).uniform(Q_MIN_rad, Q_MAX_rad)
    here = posture(q).flange_to_base
    J = posture(q).jacobian(here[:3, 3])
    for i, step in enumerate(1e-6 * np.eye(7)):
        there = posture(q + step).flange_to_base
        turn = (there[:3, :3] @ here[:3, :3].T - np.eye(3)) / 1e-6
        np.testing.assert_allclose(J[:3, i], (there[:3, 3] - here[:3, 3]) / 1e-6, atol=1e-5)
        np.testing.assert_allclose(J[3:, i], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-5)


@pytest.mark.parametrize("share", [1.0, -1.0, 1.1, -1.1])
def test_a_torque_at_the_limit_is_followed_and_one_beyond_it_is_named(share):
    beyond = abs(share) > 1
    step = np.full(7, share * TORQUE_STEP_Nm)
    strong = share * TAU_MAX_Nm
    jump = [ErrorBit.CONTROLLER_TORQUE_DISCONTINUITY] * beyond
    assert sorted(broken_rules(step)) == sorted(broken_rules(5 + step, np.full(7, 5.0))) == jump
    assert sorted(broken_rules(strong, strong)) == [ErrorBit.TAU_J_RANGE_VIOLATION] * beyond
