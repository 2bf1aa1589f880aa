"""Which pairs are kept: the score on forces made by hand, the gate on motion, the coverage."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from uniforce_robots.pairs.coverage import ENOUGH, Coverage
from uniforce_robots.pairs.pair_judge import GraspSignals, PairJudge
from uniforce_robots.pairs.track import MotionLimits, quasi_static
from uniforce_vtla.errors import ContractError

LED = slice(22, 43)  # frames in which the hand leads


def test_balance_is_left_alone(calm):
    quality = PairJudge().judge(calm)
    assert not quality.flagged.any() and quality.error[LED].max() < 0.01


def test_opposite_shear_is_flagged(calm):
    """A freely squeezed object: pads that face it askew shear it against each other."""
    askew = calm.left_N * [-1, -1, 1]
    assert PairJudge().judge(replace(calm, right_N=askew)).flagged[LED].all()


def test_an_acceleration_along_the_closing_axis_is_mass_times_it(calm):
    acceleration = calm.acceleration_m_s2.copy()
    acceleration[30, 0] = 5.0
    quality = PairJudge().judge(replace(calm, acceleration_m_s2=acceleration))
    assert quality.error[30] == pytest.approx(0.3 * 5.0 / np.linalg.norm(calm.left_N[30]), rel=0.02)
    acceleration[30] = [0.0, 5.0, 5.0]  # along the pads it loads both alike
    assert not PairJudge().judge(replace(calm, acceleration_m_s2=acceleration)).flagged.any()


def test_a_finger_that_does_not_touch_is_flagged(calm):
    left = calm.left_N.copy()
    left[25:] = 0
    quality = PairJudge().judge(replace(calm, left_N=left))
    assert (quality.error[27:] == 2).all() and not quality.flagged[LED.start : 24].any()


def test_a_strong_lean_is_flagged_and_a_light_one_is_not(calm):
    """Normals overrule the acceleration only far beyond the session's own spread."""
    for lean, flagged in ((0.9, True), (0.1, False)):
        right = calm.right_N.copy()
        right[LED, 2] *= 1 - lean * 0.9
        quality = PairJudge().judge(replace(calm, right_N=right))
        assert bool(quality.flagged[LED][2:-2].all()) is flagged


def test_the_grasp_itself_shows_how_normals_compare(calm):
    # one unit reads half as much again, from the first touch on
    stiffer = calm.right_N * [1, 1, 1.5]
    assert not PairJudge().judge(replace(calm, right_N=stiffer)).flagged.any()


def test_an_open_hand_that_is_led_to_the_object_first_changes_nothing(calm):
    """So a grasp begins on a robot: as the fingers open after the one before."""
    stiffer = replace(calm, right_N=calm.right_N * [1, 1, 1.5])
    led = 20
    free = np.zeros((led, 3))
    moving = np.full((led, 3), 0.1)
    from_open = replace(
        stiffer,
        left_N=np.concatenate([free, stiffer.left_N]),
        right_N=np.concatenate([free, stiffer.right_N]),
        velocity_m_s=np.concatenate([moving, stiffer.velocity_m_s]),
        acceleration_m_s2=np.concatenate([free, stiffer.acceleration_m_s2]),
    )
    judge = PairJudge()
    error = judge.judge(stiffer).error
    np.testing.assert_allclose(judge.judge(from_open).error[led + 2 :], error[2:], atol=1e-3)


def test_a_session_does_not_learn_from_an_idle_hand(calm):
    softer = replace(calm, right_N=calm.right_N * [0.5, 0.5, 1])
    idle = replace(calm, left_N=0 * calm.left_N, right_N=0 * calm.right_N)
    judge = PairJudge()
    for _ in range(20):
        judge.learn(softer)
    for _ in range(60):
        judge.learn(idle)
    assert not judge.judge(softer).flagged.any()


def test_the_session_shows_how_shears_compare(calm):
    softer = replace(calm, right_N=calm.right_N * [0.5, 0.5, 1])
    judge = PairJudge()
    assert judge.judge(softer).flagged[LED].any()
    for _ in range(20):
        judge.learn(softer)
    assert not judge.judge(softer).flagged.any()


def test_learning_is_not_led_astray_by_a_fifth_of_bad_grasps(calm):
    bad = replace(calm, right_N=calm.left_N * [-1, -1, 1])
    judge = PairJudge()
    for k in range(20):
        judge.learn(bad if k % 5 == 4 else calm)
    assert not judge.judge(calm).flagged.any() and judge.judge(bad).flagged[LED].all()


def test_a_grasp_may_be_judged_while_it_grows(calm):
    *arrays, mass_kg = astuple(calm)
    for count in (1, 2, 3, 20):
        part = GraspSignals(*(array[:count] for array in arrays), mass_kg)
        quality = PairJudge().judge(part)
        assert len(quality.error) == count and np.isfinite(quality.error).all()


def test_nothing_touched_is_no_error_and_no_crash(calm):
    nothing = replace(calm, left_N=np.zeros_like(calm.left_N), right_N=np.zeros_like(calm.right_N))
    judge = PairJudge()
    judge.learn(nothing)
    assert np.isfinite(judge.judge(nothing).error).all()


STILL = np.zeros((20, 3))
HELD = np.full(20, 5.0)
LIMITS = MotionLimits()


@pytest.mark.parametrize(
    "what, reason", [("speed", "fast"), ("acceleration", "jerked"), ("grip", "no contact")]
)
def test_each_limit_closes_it_and_says_why(what, reason):
    signals = {"speed": STILL.copy(), "acceleration": STILL.copy(), "grip": HELD.copy()}
    signals[what][10] = 0.0 if what == "grip" else 2.0
    reasons = quasi_static(*signals.values(), 30.0, LIMITS)
    assert reasons[10] == reason and not any(reasons[:10])


def test_it_stays_closed_until_the_rubber_has_settled():
    speed = STILL.copy()
    speed[5] = 1.0
    reasons = quasi_static(speed, STILL, HELD, 30.0, MotionLimits(settle_s=0.1)).tolist()
    assert reasons[6:9] == ["settling"] * 3 and not reasons[9]
    with pytest.raises(ContractError, match="motion limits"):
        MotionLimits(speed_m_s=0.0)


@given(arrays(np.float64, (20, 3), elements=st.floats(-1, 1)), st.integers(1, 20))
def test_it_never_looks_ahead(speed, count):
    whole = quasi_static(speed, STILL, HELD, 30.0, LIMITS)
    part = quasi_static(speed[:count], STILL[:count], HELD[:count], 30.0, LIMITS)
    assert (whole[:count] == part).all()


@given(arrays(np.float64, (30, 3), elements=st.floats(-50, 50)))
def test_every_pair_counts_once_wherever_it_lies(force):
    coverage = Coverage()
    coverage.add(force)
    assert coverage.force.sum() == 30


def test_missing_names_the_emptiest_cell():
    coverage = Coverage()
    coverage.force += ENOUGH
    coverage.force[3, 1] = 0
    assert coverage.missing() == "grip 6–9 N, pull 0.5–1.5 N"
    assert coverage.covered == pytest.approx(1 - 1 / coverage.force.size)
