"""The target moves without a jump, inside the box, and never far ahead of the robot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from properties import examples

from uniforce_robots.teleop.integrator import LONGEST_GAP_S, TargetIntegrator, TargetLimits
from uniforce_vtla.errors import ContractError

LIMITS = TargetLimits()
SPEED = np.array(LIMITS.speed)
GAP = LONGEST_GAP_S
poses = arrays(np.float64, 5, elements=st.floats(-3, 3))
START = np.array([0.5, 0.0, 0.2, 0.0, 0.05])
moves = arrays(np.float64, 5, elements=st.floats(-1e3, 1e3))
times = st.floats(-1, 1e4)


def started(at=START):
    integrator = TargetIntegrator()
    integrator.start_from(at)
    return integrator


@examples(200)
@given(poses, st.lists(st.tuples(moves, times, st.booleans()), max_size=20))
def test_no_jump_whatever_is_asked(start, orders):
    integrator = started(start)
    assert np.array_equal(integrator.target, start)
    low = np.minimum(LIMITS.low, start)
    high = np.maximum(LIMITS.high, start)
    for wish, elapsed, as_goal in orders:
        before = integrator.target
        after = (integrator.towards if as_goal else integrator.advance)(wish, elapsed)
        assert np.all(np.abs(after - before) <= SPEED * GAP + 1e-9)
        assert np.all(after >= low - 1e-12) and np.all(after <= high + 1e-12)


@examples(100)
@given(st.lists(arrays(np.float64, 5, elements=st.floats(-1, 1)), min_size=1, max_size=300))
def test_a_target_pushed_against_a_robot_that_stays_does_not_run_on(rates):
    integrator = started()
    for rate in rates:
        integrator.advance(rate, 1 / 30, START)
    assert np.all(np.abs(integrator.target - START) <= np.array(LIMITS.leash) + 1e-9)


@examples(100)
@given(
    arrays(np.float64, 5, elements=st.floats(0, 1)), arrays(np.float64, 5, elements=st.floats(0, 1))
)
def test_a_goal_in_the_box_is_reached_in_time(from_share, to_share):
    low = np.array(LIMITS.low)
    high = np.array(LIMITS.high)
    start = low + from_share * (high - low)
    goal = low + to_share * (high - low)
    integrator = started(start)
    needed = int(np.ceil(np.max(np.abs(goal - start) / SPEED) / GAP)) + 1
    for _ in range(needed):
        integrator.towards(goal, GAP)
    assert np.allclose(integrator.target, goal, atol=1e-9)


def test_speed_is_metres_per_second():
    integrator = started()
    for _ in range(30):
        target = integrator.advance(np.eye(5)[0], 1 / 30)
    assert target[0] == pytest.approx(0.5 + LIMITS.speed[0])


def test_three_positions_keep_their_direction():
    step = started().towards(START + np.array([0.1, 0.05, 0, 0, 0]), 0.1) - START
    assert step[1] / step[0] == pytest.approx(0.5)


def test_a_leash_lets_go_towards_the_robot():
    integrator = started()
    along_x = np.eye(5)[0]
    # pushed; the target is behind it by more than the leash
    away = START + 0.1 * along_x
    assert integrator.advance(along_x, 0.1, away)[0] > 0.5
    assert integrator.advance(-along_x, 0.1, away)[0] >= 0.5


@pytest.mark.parametrize(
    "wrong",
    [{"speed": (1, 2)}, {"low": (np.nan,) * 5}, {"low": (1.0,) * 5}, {"leash": (-1.0,) * 5}],
)
def test_impossible_limits_are_refused(wrong):
    with pytest.raises(ContractError):
        TargetLimits(**wrong)
