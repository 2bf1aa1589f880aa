"""Ink wears by pressure and sliding; scripts look after a sweep and wipe again if ink is left."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from lerobot_env_uniforce_wiping import LEVELS, WipeEnv, WipeExpert, draw_scene
from lerobot_env_uniforce_wiping.episodes import walk
from lerobot_env_uniforce_wiping.ink import InkField
from lerobot_env_uniforce_wiping.levels import CONTROL_HZ
from lerobot_env_uniforce_wiping.rewrite import Rewrite, RewriteSettings
from lerobot_env_uniforce_wiping.sequence import LOOKS_BACK, Sweep, look_back

SEED = 9001
EVERYWHERE = RewriteSettings(1.0, (5.0, 5.0), (0.1, 0.1), (0.2, 0.2), (1.0, 1.0))


@pytest.fixture
def env():
    env = WipeEnv("touch", drawn=())
    env.start(SEED)
    return env


def run(env, disturb):
    expert = WipeExpert()
    phases = []
    for _ in walk(env, expert, SEED):
        if expert.phase not in phases[-1:]:
            phases.append(expert.phase)
        disturb(env.sim.ink, expert.phase == "wipe")
    return phases


@pytest.mark.parametrize("row", [0, 1, 2])
def test_wiping_begins_again_at_the_first_row_with_ink(env, row):
    ink = env.sim.ink
    sweep = Sweep(env.level)
    board_m = env.level.layout.board_center_m[0] + env.scene.board_shift_m[0]
    x_m = sweep.corners[2 * row, 0] - board_m
    ink.ink[:] = 1.0 * ((ink.x_m > x_m - 0.004) & (np.abs(ink.y_m) < 0.05))
    ink.version += 1
    assert np.array_equal(sweep.point(sweep.row_at(look_back(env))), sweep.corners[2 * row])


def test_the_expert_goes_back_once_and_leaves_a_clean_board(env):
    phases = run(env, Rewrite(0, EVERYWHERE).apply)
    once = ["lift", "carry", "lower", "wipe"]
    assert phases == ["descend", "close", *once, *once, "leave"]
    assert env.result().success


def test_a_board_that_is_clean_is_wiped_once(env):
    assert run(env, lambda ink, wiping: None).count("wipe") == 1


def test_ink_that_never_goes_is_given_up():
    env = WipeEnv("easy", drawn=(), max_steps=round(40 * CONTROL_HZ))
    phases = run(env, lambda ink, wiping: ink.rewrite(np.zeros(2), np.array([0.2, 0.3]), 1.0))
    assert phases.count("wipe") == 1 + LOOKS_BACK and phases[-1] == "done"
    assert env.result().outcome == "residual"


def written():
    """Return the ink of a board, as it is before the episode."""
    return InkField(draw_scene(SEED, "touch"))


def test_ink_comes_back_where_it_was_and_not_darker():
    ink = written()
    first = ink.ink.copy()
    ink.rewrite(np.zeros(2), np.array([0.2, 0.3]), 0.5)
    assert np.array_equal(ink.ink, first)  # nothing was gone
    ink.ink[:] = 0
    ink.rewrite(np.array([0.02, 0.0]), np.array([0.03, 0.3]), 0.5)
    back = ink.ink > 0
    assert back.any() and np.array_equal(ink.ink[back], 0.5 * first[back])
    assert np.abs(ink.x_m[back] - 0.02).max() <= 0.015 and 0 < ink.residual < 1
    center_m, extent_m = ink.written_box_m
    places_m = np.stack([ink.x_m, ink.y_m])[:, first > 0]
    assert np.allclose(places_m.min(axis=1), center_m - extent_m / 2)
    assert np.allclose(places_m.max(axis=1), center_m + extent_m / 2)


def test_ink_comes_back_once_while_wiping_and_the_same_each_time():
    def boards(seed):
        ink = written()
        ink.ink[:] = 0
        rewrite = Rewrite(seed, RewriteSettings(share=1.0))
        seen = []
        for step in range(round(8 * CONTROL_HZ)):
            rewrite.apply(ink, wiping=step % 2 == 0)  # half of the time: 4 s of wiping
            seen.append(ink.ink.tobytes())
        return seen

    early = [seed for seed in range(20) if len(set(boards(seed))) == 2]
    assert 1 <= len(early) < 20  # some within 4 s, some later
    assert boards(early[0]) == boards(early[0])


def test_the_share_of_episodes_is_the_one_asked_for():
    ink = written()
    again = 0
    for seed in range(300):
        ink.ink[:] = 0
        rewrite = Rewrite(seed)
        for _ in range(round(7 * CONTROL_HZ)):
            rewrite.apply(ink, wiping=True)
        again += ink.ink.any()
    assert abs(again / 300 - RewriteSettings().share) < 0.1


FELT_m = np.array([0.2, 0.3])  # covers the whole board
FROM_N = LEVELS["touch"].wear_from_N


def left_after(press_N, slide_m=0.06, off_center_m=0.0):
    """Return the ink under one felt as large as the board, scaled to an eraser's pressure."""
    ink = written()
    eraser_m2 = 0.030 * 0.060
    ink.wear *= float(np.prod(FELT_m)) / eraser_m2
    ink.wipe(np.zeros(2), 0.0, FELT_m, np.array([press_N, off_center_m, 0.0]), slide_m)
    return ink.ink


@examples(20)
@given(st.floats(0, FROM_N), st.floats(-0.05, 0.05))
def test_felt_that_presses_too_lightly_glides_over_the_ink(press_N, off_center_m):
    assert np.array_equal(left_after(press_N, off_center_m=off_center_m), written().ink)


@examples(20)
@given(st.floats(FROM_N + 0.1, 12), st.floats(1.05, 2))
def test_who_presses_harder_or_slides_farther_leaves_less(press_N, more):
    inked = written().ink > 0
    once = left_after(press_N)[inked]
    assert (left_after(press_N * more)[inked] < once).all()
    assert (left_after(press_N, slide_m=0.06 * more)[inked] < once).all()


def test_two_sweeps_wear_as_much_as_one_with_twice_the_force_above_the_threshold():
    inked = written().ink > 0
    twice = left_after(5.0, slide_m=0.12)[inked]
    assert np.allclose(twice, left_after(FROM_N + 2 * (5.0 - FROM_N))[inked], rtol=1e-4)
