"""Every guard by itself and in turn: NaN stops, the rest clamps, and all count."""

from itertools import pairwise

import numpy as np
import pytest
from robot_fakes import refused

from uniforce_robots.franka.guards import GuardChain, GuardLimits

HERE = np.array([0.45, 0.0, 0.30, 0.0, 0.06])


def away(x, y=0.0, z=0.0, yaw=0.0, width=0.0):
    return HERE + np.array([x, y, z, yaw, width])


WIDE = GuardLimits(
    low=(0.42, -0.04, 0.27, -0.3, 0.04),
    high=(0.48, 0.04, 0.33, 0.3, 0.07),
    speed_m_s=0.5,
    speed_rad_s=2.5,
    speed_width_m_s=0.2,
    step_m=0.1,
    step_rad=0.8,
    longest_gap_s=0.2,
)


def test_a_good_action_passes_unchanged_and_counts_nothing():
    chain = GuardChain(GuardLimits())
    action = away(0.003, -0.002, -0.004, 0.02, -0.002)
    np.testing.assert_allclose(chain(action, HERE, 0.0), action)
    assert not any(chain.counts.values())


def test_the_box_clamps():
    chain = GuardChain(WIDE)
    sent = chain(np.array([5.0, -5.0, -1.0, 9.0, 0.5]), HERE, 0.0)
    np.testing.assert_allclose(sent, [0.48, -0.04, 0.27, 0.3, 0.07])
    assert chain.counts == {"finite": 0, "box": 1, "step": 0, "rate": 0, "sensor": 0}


def test_a_step_is_counted_from_the_measured_pose_and_keeps_its_direction():
    chain = GuardChain(GuardLimits(speed_m_s=0.5, speed_rad_s=2.5, longest_gap_s=0.2))
    sent = chain(away(0.12, 0.16, 0, 1.0), HERE, 0.0)
    np.testing.assert_allclose(sent[:3] - HERE[:3], [0.03, 0.04, 0])
    assert sent[3] == pytest.approx(0.35) and chain.counts["step"] == 1


def test_the_rate_is_counted_from_the_last_target_and_the_time_since():
    chain = GuardChain(GuardLimits(speed_m_s=0.3, step_m=0.1))
    first = chain(HERE, HERE, 10.0)
    sent = chain(away(0.1), HERE, 10.05)
    assert sent[0] - first[0] == pytest.approx(0.3 * 0.05) and chain.counts["rate"] == 1
    after_a_pause = chain(away(0.1), HERE, 99.0)
    assert after_a_pause[0] - sent[0] == pytest.approx(0.3 * 0.1), "a pause does not buy a jump"


def test_a_guard_that_begins_to_act_is_logged_once(caplog):
    chain = GuardChain(WIDE)
    for i in range(5):
        chain(away(9), HERE, float(i))
    assert caplog.text.count("guard box") == 1
    chain(HERE, HERE, 6.0)
    chain(away(9), HERE, 7.0)
    assert caplog.text.count("guard box") == 2 and chain.counts["box"] == 6


def test_outside_the_box_stay_stays_and_only_a_wish_inwards_moves():
    chain = GuardChain(GuardLimits())
    outside = away(0.35)
    further = away(0.45)
    inside = away(0.15)
    np.testing.assert_allclose([chain(outside, outside, 0.1 * i) for i in range(3)], [outside] * 3)
    wishes = enumerate([further, inside, inside, further])
    x = [chain(wish, outside, 1 + 0.1 * i)[0] for i, wish in wishes]
    assert x[0] == 0.80 and x[1] < 0.79 and all(a >= b for a, b in pairwise(x))


def test_a_measured_pose_that_is_no_number_stops():
    chain = GuardChain(GuardLimits())
    with refused("bad_state"):
        chain(HERE, HERE * np.nan, 0.0)
