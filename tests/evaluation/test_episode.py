from dataclasses import replace

import numpy as np
import pytest
from episode_samples import N, good_trace
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.episode import (
    STEP_FIELDS,
    EpisodeTrace,
    ScoreLimits,
    empty_trace,
    running_mean,
    score_episode,
)


def at(values, where, to):
    changed = values.copy()
    changed[where] = to
    return changed


def test_good_episode_is_a_clean_success():
    result = score_episode(good_trace())
    assert result.outcome == "success" and result.clean and result.reasons == ()
    assert result.metrics["press_mean_N"] == pytest.approx(6.0)


def test_a_failed_grasp_comes_before_residual_ink():
    dirty = good_trace(residual=np.ones(N))
    assert score_episode(dirty).outcome == "residual"
    dropped = {"grip_left_N": np.zeros(N), "grip_right_N": np.zeros(N)}
    slipped = {"slip_mm": at(np.zeros(N), slice(90, N), 21.0)}
    for fault in (dropped, {"phase": np.zeros(N)}, slipped):
        assert score_episode(replace(dirty, **fault)).outcome == "failed_grasp"


def test_one_loose_pad_or_a_short_gap_is_no_drop():
    trace = good_trace()
    short = at(trace.grip_left_N, slice(60, 66), 0.0)
    assert score_episode(replace(trace, grip_left_N=np.zeros(N))).success
    assert score_episode(replace(trace, grip_left_N=short, grip_right_N=short)).success


def test_slow_and_quick_slip():
    slow = np.linspace(0, 4.5, N)  # 0.56 mm in 0.5 s
    assert not score_episode(good_trace(slip_mm=slow)).slippage
    assert score_episode(good_trace(slip_mm=slow * 1.2)).slippage  # 5.4 mm since the lift
    assert score_episode(good_trace(slip_mm=at(np.zeros(N), slice(70, N), 3.5))).slippage


@pytest.mark.parametrize(
    "field, steps, value, excess",
    [
        ("press_N", 20, 10.5, True),  # 0.67 s above 10 N
        ("press_N", 6, 12.0, False),  # 0.2 s only: the mean stays below
        ("press_N", 1, 15.5, True),
        ("depth_left_mm", 1, 1.6, True),
        ("depth_right_mm", 1, 1.6, False),  # rated 5 mm
    ],
)
def test_excess_force(field, steps, value, excess):
    base = good_trace()
    values = at(getattr(base, field), slice(60, 60 + steps), value)
    result = score_episode(replace(base, **{field: values}))
    assert result.excess_force is excess
    assert result.success and result.clean is not excess


@pytest.mark.parametrize("inside, clean", [(0.85, True), (0.75, False)])
def test_a_clean_wipe_presses_within_the_band_over_most_of_the_way(inside, clean):
    """By distance: a slow stretch beside the band counts as little as it slides."""
    slide_mm, press_N = np.zeros(N), good_trace().press_N
    wiping = np.flatnonzero(press_N)
    within, beside = wiping[:20], wiping[20:]
    slide_mm[within] = inside / len(within)
    slide_mm[beside] = (1 - inside) / len(beside)
    press_N[beside] = 9.0
    trace = good_trace(slide_mm=slide_mm, press_N=press_N)
    result = score_episode(trace, ScoreLimits(in_band_share=0.8))
    assert result.metrics["in_band_share"] == pytest.approx(inside)
    assert result.success and result.clean is clean
    assert score_episode(trace).clean, "without a band in the limits"


def test_an_empty_trace_is_aborted_and_bad_ones_are_refused():
    assert score_episode(empty_trace()).outcome == "aborted"
    with pytest.raises(ContractError, match="finite"):
        good_trace(press_N=np.full(N, np.nan))
    with pytest.raises(ContractError, match="One value per step"):
        good_trace(press_N=np.zeros(N - 1))


columns = st.lists(st.floats(0, 30), min_size=8, max_size=40)


def _random_trace(values, residual):
    n = len(values)
    fields = dict.fromkeys(STEP_FIELDS, np.asarray(values)) | {"time_s": (np.arange(n) + 1) / 30}
    fields |= {"residual": np.full(n, residual), "phase": np.full(n, 2)}
    return EpisodeTrace(**fields, rated_depth_mm=(1.5, 5.0))


@examples(40)
@given(columns, st.floats(1.0, 4.0))
def test_events_are_monotone_in_what_they_measure(values, factor):
    base = _random_trace(values, 0.0)
    worse = replace(base, press_N=base.press_N * factor, slip_mm=base.slip_mm * factor)
    before, after = score_episode(base), score_episode(worse)
    assert before.excess_force <= after.excess_force and before.slippage <= after.slippage


@examples(40)
@given(columns, st.floats(0.0, 1.0))
def test_stricter_limits_never_make_an_episode_cleaner(values, share):
    trace = _random_trace(values, 0.05)
    strict = ScoreLimits(residual_share=0.1 * share, slip_mm=5 * share, mean_press_N=10 * share)
    assert score_episode(trace, strict).clean <= score_episode(trace).clean


def test_running_mean_of_a_constant():
    time_s = (np.arange(30) + 1) / 30
    assert np.allclose(running_mean(np.full(30, 3.0), 0.5, time_s), 3.0)
    assert running_mean(np.arange(5.0), 10.0, time_s[:5]) == pytest.approx([2.0])
