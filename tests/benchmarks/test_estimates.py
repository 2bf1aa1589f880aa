"""How well fingers judge a wipe: made-up forces whose answer is known, and one real wipe."""

import numpy as np
import pytest
from episode_samples import N, good_trace

from benchmarks.estimates import FeltWipe, errors, felt_wipe, judge
from lerobot_env_uniforce_wiping import WipeEnv
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.force_sensor import ForceSensor


def made_up(read_press_N, true_press_N=6.0):
    """A wipe that presses with ``true_press_N`` while its fingers read ``read_press_N``."""
    t = np.arange(N) / 30
    grip = np.where(t > 0.5, 9.0, 0.0)

    def pads(press_N):
        up = (1.0 - np.interp(t, [2.0, 2.5], [0.0, press_N])) / 2 * (t > 1)
        return np.repeat(np.column_stack([0 * t, up, grip])[:, None], 2, axis=1)

    return FeltWipe(
        pads(read_press_N),
        pads(true_press_N),
        np.column_stack([0 * t, 0 * t, np.interp(t, [0.8, 1.5], [0.1, 0.2])]),
        {"left": "gelsight", "right": "tactip"},
        (0.9, 0.9),
        good_trace(
            time_s=t,
            press_N=np.interp(t, [2.0, 2.5], [0.0, true_press_N]),
            phase=np.digitize(t, [1.2, 2.0]),
        ),
    )


def test_what_is_read_rightly_is_judged_rightly():
    row = judge(made_up(6.0))
    assert row["press_mae_N"] == pytest.approx(0.0, abs=1e-6)
    assert row["press_above_limit"] == [False, False]
    assert row["slippage"] == [False, False]


def test_what_is_read_wrongly_is_judged_wrongly():
    row = judge(made_up(13.0))
    assert row["press_mae_N"] > 5.0
    assert row["press_above_limit"] == [False, True]


def test_errors_are_those_of_the_finger_that_wore_the_sensor():
    wipe = made_up(6.0)
    wipe.force_N[:, 1] += 0.5
    found = errors([wipe, wipe])
    assert found["gelsight"]["mae_N"] == [0.0, 0.0, 0.0]
    assert found["tactip"]["mae_N"] == pytest.approx([0.5, 0.5, 0.5])


def test_a_wipe_is_read_whole_by_both_fingers():
    env = WipeEnv("touch", "gelsight:any", "tactip:any")
    wipe = felt_wipe(env, {finger: ForceSensor("", finger) for finger in FINGERS}, 70_500)
    assert wipe.force_N.shape == wipe.true_force_N.shape == (len(wipe.trace.time_s), 2, 3)
    held = wipe.true_force_N[..., 2] > 3.0
    assert np.abs(wipe.force_N - wipe.true_force_N)[held].mean() < 1.5
