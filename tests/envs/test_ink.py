"""Ink is worn off by pressure and sliding, and not at all by a hand that is too light."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from lerobot_env_uniforce_wiping import LEVELS, draw_scene
from lerobot_env_uniforce_wiping.ink import InkField

FELT_m = np.array([0.2, 0.3])  # covers the whole board
FROM_N = LEVELS["paper"].wear_from_N


def left_after(press_N: float, slide_m: float = 0.06, off_center_m: float = 0.0) -> np.ndarray:
    """Return the ink of a board under one felt as large as itself, scaled to an eraser's pressure."""
    ink = InkField(draw_scene(3, "paper"))
    eraser_m2 = 0.030 * 0.060
    ink.wear *= float(np.prod(FELT_m)) / eraser_m2
    ink.wipe(np.zeros(2), 0.0, FELT_m, np.array([press_N, off_center_m, 0.0]), slide_m)
    return ink.ink


@examples(20)
@given(st.floats(0, FROM_N), st.floats(-0.05, 0.05))
def test_felt_that_presses_too_lightly_glides_over_the_ink(press_N: float, off_center_m: float) -> None:
    first = InkField(draw_scene(3, "paper")).ink
    assert np.array_equal(left_after(press_N, off_center_m=off_center_m), first)


@examples(20)
@given(st.floats(FROM_N + 0.1, 12), st.floats(1.05, 2))
def test_who_presses_harder_or_slides_farther_leaves_less(press_N: float, more: float) -> None:
    inked = InkField(draw_scene(3, "paper")).ink > 0
    once = left_after(press_N)[inked]
    assert (left_after(press_N * more)[inked] < once).all()
    assert (left_after(press_N, slide_m=0.06 * more)[inked] < once).all()


def test_two_sweeps_wear_as_much_as_one_with_twice_the_force_above_the_threshold() -> None:
    inked = InkField(draw_scene(3, "paper")).ink > 0
    twice = left_after(5.0, slide_m=0.12)[inked]
    assert np.allclose(twice, left_after(FROM_N + 2 * (5.0 - FROM_N))[inked], rtol=1e-4)
