"""Sessions made here: a pad that objects bend, clipped on anew between them; which frame of a film
is free air."""

import numpy as np
import pytest

from benchmarks.real.free_frame import Film, SAME_px, borrowed, pads
from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers.raster import CENTRE_PX
from uniforce_vtla.sensors.layouts import rectangular, turned

PITCH_px = 60.0
WIDTH_px = 60.0  # of a dent


def pattern(seed):
    """A printed grid (M, 2) px whose markers stand where the printer put them: a pad is known by
    that."""
    grid = CENTRE_PX + rectangular(7, 9, (PITCH_px, PITCH_px))
    return grid + np.random.default_rng(seed).normal(0, 3, grid.shape)


def pressed(centres_px, place, by_px):
    """Markers spread outwards around a place."""
    away = centres_px - place
    width = np.exp(-(away**2).sum(axis=1, keepdims=True) / (2 * WIDTH_px**2))
    return centres_px + by_px * width * away / WIDTH_px


def film(pad, held, number, free_at=0, frames=6):
    """A film of an object pressed at its own place; its pad sits a little differently, and markers
    jitter."""
    rng = np.random.default_rng(number)
    place = np.random.default_rng(len(held) * 7 + ord(held[0])).uniform(150, 400, 2)
    turn_rad = rng.uniform(-0.02, 0.02)
    shift_px = rng.uniform(-6, 6, 2)
    found = []
    for frame in range(frames):
        by_px = 0.0 if frame == free_at else 6.0 + 2 * frame
        moved = turned(pressed(pad, place, by_px), turn_rad) + shift_px
        found.append((moved + rng.normal(0, 0.15, moved.shape)).astype(np.float32))
    return Film(held, found)


def three_films(pad):
    return [film(pad, held, number) for number, held in enumerate(("ball", "mug", "lemon"))]


def test_the_free_frame_is_the_one_that_comes_back_with_other_objects():
    one = pattern(1)
    films = [
        film(one, "ball", 0, 0),
        film(one, "mug", 1, 3),
        film(one, "lemon", 2, 5),
        film(one, "walnut", 3, None),
    ]
    found, free = pads(films)
    assert len(found) == 1 and found[0].films == (0, 1, 2, 3)
    frames = [None if frame is None else frame.frame for frame in free]
    assert frames == [0, 3, 5, None]
    assert all(frame.off_px < SAME_px for frame in free[:3])


def test_a_frame_is_borrowed_of_the_same_object_first_and_of_no_other_pad():
    one = pattern(1)
    films = three_films(one)
    for held in ("mug", "lemon", "walnut"):
        films.append(film(one, held, len(films), None))
    films.append(film(pattern(2), "ball", 6, None))
    found, free = pads(films)
    lent = [None if frame is None else frame.film for frame in borrowed(films, found, free)]
    assert lent[:5] == [0, 1, 2, 1, 2] and lent[5] in (0, 1, 2) and lent[6] is None


def test_a_grasp_that_is_repeated_with_one_object_is_not_taken_for_free_air():
    ball = film(pattern(1), "ball", 0, None)
    assert pads([ball] * 5) == ([], [None] * 5)


def test_pads_of_one_layout_are_told_apart_by_their_print():
    found, free = pads(three_films(pattern(1)) + three_films(pattern(2)))
    assert sorted(pad.films for pad in found) == [(0, 1, 2), (3, 4, 5)]
    assert [frame.frame for frame in free] == [0] * 6


def test_markers_that_the_border_cuts_off_are_left_out():
    films = three_films(pattern(1))
    films[1] = Film("mug", [centres_px[3:] for centres_px in films[1].centres_px])
    _, free = pads(films)
    assert [frame.frame for frame in free] == [0] * 3


def test_no_films_are_refused():
    with pytest.raises(ContractError, match="films"):
        pads([])
    with pytest.raises(ContractError, match="films"):
        pads([Film("ball", [])])
