"""Agreement of two fingers: the sealed objects are drawn by hash, contact is shading, the formula
is as fixed."""

import hashlib

import cv2
import numpy as np
import pytest

from benchmarks.real.free_frame import FreeFrame
from benchmarks.real.grasps import (
    SEALED,
    SEEN,
    SHADED,
    Films,
    Grasp,
    Reading,
    Score,
    agreement,
    by_chance,
    by_group,
    read_grasp,
    shading,
    summary,
)

OTHERS = """
    artificial_strawberry avocado_real bag_of_peanuts bag_straws ball_white_thread baseball
    blue_box blue_mug cellotape cheese_tube glass_box green_rope jute_basket lemon marker_pen
    nylon_thread pattern_cotton_cloth plastic_cup plug_3D red_sticker_tape rubber_hand rubber_pear
    rubber_salmon_fillet screw_driver_blue_gray screw_driver_red silicone_salmon_fillet
    tennis_ball wallet wire3D wooden_mat wooden_statue
"""


def test_the_sealed_objects_are_the_first_six_by_hash():
    others = OTHERS.split()
    by_hash = sorted(others, key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    assert list(SEALED) == by_hash[:6]
    assert not {*SEALED} & {*SEEN} and not {*others} & {*SEEN}


def test_contact_is_seen_by_shading_and_exposure_is_none():
    free = np.full((240, 320, 3), 120, np.uint8)
    for column in range(20, 320, 40):
        cv2.circle(free, (column, 120), 6, (20, 20, 20), cv2.FILLED)
    darker = (free * 0.8).astype(np.uint8)
    dented = free.copy()
    cv2.circle(dented, (160, 120), 60, (150, 130, 140), cv2.FILLED)
    assert shading(free, free) == 0.0
    assert shading(darker, free) < SHADED < shading(dented, free)


def test_the_error_is_the_mean_difference_over_the_mean_of_both():
    nothing = {"left": np.zeros((4, 2, 2)), "right": np.zeros((4, 2, 2))}
    force_N = {"left": np.array([1.0, 2.0, 3.0, 4.0]), "right": np.array([2.0, 2.0, 4.0, 4.0])}
    grasp = Grasp("ball", "close", nothing, nothing)
    found = agreement(read_grasp(grasp, lambda reference, current, finger: force_N[finger]))
    assert found.relative_error == pytest.approx((0.5) / 2.75) and found.frames == 4
    assert found.r == pytest.approx(np.corrcoef(force_N["left"], force_N["right"])[0, 1])


def test_objects_are_drawn_anew_and_not_trials():
    """Twenty trials of one object and one of another: the interval reaches from one object's error
    to the other's."""
    mug, ball = Score("mug", "close", 9, 0.1, 0.9, 0.2), Score("ball", "close", 9, 0.7, 0.2, 0.2)
    found = summary([mug] * 20 + [ball])
    assert (found["objects"], found["trials"], found["relative_error"]) == (2, 21, 0.1)
    assert found["relative_error_95"] == [pytest.approx(0.1), pytest.approx(0.7)]


def test_a_borrowed_reference_is_another_films_frame_and_is_marked():
    frames = [[f"film {film}, frame {number}" for number in range(3)] for film in range(3)]
    films = Films(frames, [FreeFrame(0, 2, 0.1, 0), FreeFrame(0, 2, 0.1, 0), None])
    assert films.reference(0) == "film 0, frame 2" and not films.is_borrowed(0)
    assert films.reference(1) == "film 0, frame 2" and films.is_borrowed(1)
    assert films.reference(2) is None and not films.is_borrowed(2)


def test_chance_pairs_fingers_that_held_different_objects():
    ball = Reading("ball", "close", np.full(5, 1.0), np.full(5, 2.0))
    again = Reading("ball", "close", np.full(4, 3.0), np.full(4, 4.0))
    mug = Reading("mug", "close", np.full(3, 5.0), np.full(3, 6.0))
    found = by_chance([ball, again, mug])
    assert np.array_equal([one.left_N for one in found], [[1] * 3, [3] * 3, [5] * 3])
    assert np.array_equal([one.right_N for one in found], [[6] * 3, [6] * 3, [2] * 3])
    assert by_chance([ball, again]) == []


def test_groups_are_summed_up_apart():
    force_N = np.array([1.0, 2.0, 3.0])
    ball = Reading("ball", "close", force_N, force_N)
    mug = Reading("mug", "wide, borrowed", force_N, 2 * force_N)
    found = by_group([ball, mug])
    assert list(found) == ["close", "wide, borrowed"]
    assert found["close"]["relative_error"] == 0.0 < found["wide, borrowed"]["relative_error"]
