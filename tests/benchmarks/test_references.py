"""Films made here: patterns are laid on each other, borrowed frames show where a pad sat, and mounts are recognised."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.real.references import (
    Seen,
    borrowed_rows,
    free_rows,
    mean_motion,
    mount_rows,
    pad_row,
    placed,
)
from uniforce_datasets.readers.gelsight_grasps import GraspTrial
from uniforce_vtla.markers.film_markers import FilmMarkers
from uniforce_vtla.markers.free_frame import Film, FreeFrame, pads

PITCH_px = 60.0


def pattern() -> np.ndarray:
    x, y = np.meshgrid(np.arange(9), np.arange(7))
    grid = np.column_stack([x.ravel(), y.ravel()]) * PITCH_px + 60
    return grid + np.random.default_rng(1).normal(0, 3, grid.shape)


def film(held: str, number: int, mounted_px: tuple[float, float], is_free: bool = True) -> Film:
    """Three frames: free air, if at all, and two presses; the pad sits where it was mounted."""
    rng = np.random.default_rng(number)
    shown = []
    for by_px in (0.0 if is_free else 6.0, 9.0, 12.0):
        away = pattern() - np.array([150 + 30 * len(held), 250])
        dent = by_px * np.exp(-(away**2).sum(axis=1, keepdims=True) / 7200) * away / 60
        shown.append(pattern() + dent + mounted_px + rng.normal(0, 0.1, away.shape))
    return Film(held, shown)


@pytest.fixture
def session() -> list[Film]:
    """Two films an object; the pad was mounted anew, 5 px off, for the last object."""
    places = {"mug": (0.0, 0.0), "lemon": (0.0, 0.0), "walnut": (5.0, 0.0)}
    films = [
        film(held, 2 * n + take, places[held]) for n, held in enumerate(places) for take in (0, 1)
    ]
    return [*films, film("walnut", 9, (5.0, 0.0), is_free=False)]


def test_what_is_free_and_how_sure_the_pattern_is(session: list[Film]) -> None:
    known, free = pads(session)
    rows = free_rows(known, free)
    assert (rows["own"], rows["contact_only"], rows["pattern_not_shared"]) == (6, 1, 0)
    assert 0.05 < rows["off_px"]["median"] < 0.3
    row = pad_row(known[0], session, free)
    assert row["objects"] == 3 and 0.02 < row["halves_apart_px"]["worst"] < 0.2


def test_a_frame_of_the_same_object_lies_nearer_than_one_of_another_mounting(
    session: list[Film],
) -> None:
    known, free = pads(session)
    best = next(n for n, own in enumerate(free) if own is not None and session[n].held == "mug")
    sure = [
        FreeFrame(own.film, own.frame, 0.0 if n == best else 0.2, 0) if own else None
        for n, own in enumerate(free)
    ]
    rows = borrowed_rows(session, known, sure)
    assert rows["same_object_first"]["worst"] < 0.3 and rows["any_object"][
        "worst"
    ] == pytest.approx(5.0, abs=0.2)


def test_a_turned_frame_is_laid_on_the_pattern_and_a_missing_marker_stays_missing() -> None:
    turn = np.array([[np.cos(0.03), np.sin(0.03)], [-np.sin(0.03), np.cos(0.03)]])
    seen = np.delete(pattern(), 5, axis=0) @ turn + (4, -3)
    places = placed(pattern(), seen)
    assert np.isnan(places[5]).all() and np.nanmax(np.abs(places - pattern())) < 1e-3


@pytest.mark.parametrize(("sign", "mount"), [((-1, 1), "upright"), ((1, -1), "turned")])
def test_grasps_say_how_the_fingers_are_mounted(sign: tuple[int, int], mount: str) -> None:
    """In its own picture, the upright right finger sees a load that both carry mirrored along x."""
    pull_px = np.random.default_rng(0).normal(0, 2, (30, 2))
    trial = GraspTrial("mug", "mug/exp_num_1", "wide", {}, False)

    def seen(along: tuple[int, int]) -> Seen:
        centres_px = tuple(pattern() + shift * along for shift in pull_px)
        return Seen(
            trial, Path("film.avi"), FilmMarkers((240, 320, 3), tuple(range(30)), centres_px, {})
        )

    left, right = seen((1, 1)), seen(sign)
    moved = np.stack(list(mean_motion(left.markers).values()))
    assert np.allclose(moved - moved[0], pull_px - pull_px[0])
    assert mount_rows([left, right]) == {"mug": {mount: 1}}
