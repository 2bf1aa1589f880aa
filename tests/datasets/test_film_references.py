"""Sessions of films made here: whose free frame is found, who has none, who may borrow, and what can't be read."""

import shutil

import cv2
import numpy as np
import pytest

from uniforce_datasets.film_references import film_references
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.markers.film_markers import SETTLE, STEP
from uniforce_vtla.sensors.layouts import rectangular

SIZE_px = (320, 240)
PITCH_px = 30
LOOKED_AT = 4  # frames of a film
PLACES = {"ball": (90, 80), "mug": (220, 100), "lemon": (100, 170), "walnut": (230, 180)}


def printed():
    """Markers (M, 2) px of a pad, each a little off its grid, as printers put them."""
    grid = rectangular(7, 10, (PITCH_px, PITCH_px)) + np.array(SIZE_px) / 2
    return grid + np.random.default_rng(0).normal(0, 1.5, grid.shape)


def frame(centres_px):
    picture = np.full((*SIZE_px[::-1], 3), (120, 150, 140), np.uint8)
    for at in np.rint(16 * centres_px).astype(int).tolist():
        cv2.circle(picture, at, 16 * 5, (20, 20, 20), cv2.FILLED, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(picture, (0, 0), 1.0)


def frames_of(held, free_at):
    """A film (T, H, W, 3) of an object that presses from frame to frame, but for one of those looked at."""
    away = printed() - PLACES[held]
    spread = np.exp(-(away**2).sum(axis=1, keepdims=True) / (2 * 40.0**2)) * away / 40.0
    shown = []
    for number in range(LOOKED_AT):
        by_px = 0.0 if number == free_at else 4.0 + 1.5 * number
        shown += [frame(printed() + by_px * spread)] * STEP
    return np.stack([*[shown[0]] * SETTLE, *shown])


def write(path, frames):
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, frames)
        return
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, frames.shape[2:0:-1])
    for one in frames:
        writer.write(one[..., ::-1])
    writer.release()


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    root = tmp_path_factory.mktemp("session")
    write(root / "ball" / "take_1" / "left.avi", frames_of("ball", 0))
    write(root / "mug" / "film.npy", frames_of("mug", 2))
    write(root / "lemon.npy", frames_of("lemon", 3))
    write(root / "walnut" / "film.npy", frames_of("walnut", None))
    return root


def by_film(found):
    return {one.film: one for one in found}


def test_each_film_has_its_own_free_frame_or_says_that_it_has_none(session):
    found = by_film(film_references(session, "gelsight"))
    own = {name: one.frame for name, one in found.items() if not one.why}
    assert own == {
        "ball/take_1/left.avi": SETTLE,
        "lemon.npy": SETTLE + 3 * STEP,
        "mug/film.npy": SETTLE + 2 * STEP,
    }
    assert all(found[name].of == name and found[name].off_px < 0.3 for name in own)
    assert {one.held for one in found.values()} == set(PLACES)
    none = found["walnut/film.npy"]
    assert none.why.startswith("walnut/film.npy: expected a free frame of pad 0")
    assert "borrow=true" in none.why
    assert not none.of and none.read == LOOKED_AT and not none.refused


def test_a_frame_is_borrowed_when_asked_for_alone_and_says_whose_it_is(session):
    found = by_film(film_references(session, "gelsight", borrow=True))
    lent = found["walnut/film.npy"]
    assert not lent.why and lent.frame == found[lent.of].frame
    assert [name for name, one in found.items() if one.is_borrowed] == ["walnut/film.npy"]


def test_films_that_can_not_be_used_are_named_and_the_others_go_on(session, tmp_path):
    shutil.copytree(session, tmp_path, dirs_exist_ok=True)
    ball = frames_of("ball", 0)
    write(tmp_path / "big" / "film.npy", ball.repeat(2, axis=1).repeat(2, axis=2))
    write(tmp_path / "dark" / "film.npy", np.zeros((SETTLE + 2, 240, 320, 3), np.uint8))
    write(tmp_path / "short" / "film.npy", ball[:SETTLE])
    write(tmp_path / "floats" / "film.npy", np.zeros((3, 240, 320, 3), np.float32))
    (tmp_path / "torn.mp4").write_bytes(b"no film")
    found = by_film(film_references(tmp_path, "gelsight"))
    reasons = {
        "big/film.npy": r"expected (240, 320, 3), got (480, 640, 3)",
        "dark/film.npy": "none of 1 frames can be read; frame 10: camera frame: expected a lit gel",
        "short/film.npy": "more than 10 frames",
        "floats/film.npy": "(T, H, W, 3) uint8",
        "torn.mp4": "whole film",
        "walnut/film.npy": "free frame of pad 0",
    }
    said = {name: one.why for name, one in found.items() if one.why}
    assert said.keys() == reasons.keys()
    for name, why in said.items():
        assert reasons[name] in why and name in why and "\n" not in why


def test_a_folder_without_films_and_a_sensor_that_is_no_camera_are_refused(session, tmp_path):
    with pytest.raises(DatasetError, match="folder of one session"):
        film_references(tmp_path, "gelsight")
    with pytest.raises(ContractError, match="camera sensor"):
        film_references(session, "uskin")
