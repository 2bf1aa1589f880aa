"""Cameras: markers are found whatever their colour, count and light, and never invented."""

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer


def missed_and_false(scene, canonicalizer, within_px=4.0):
    """Count true markers that nothing was found at, and found ones that aren't there."""
    found = canonicalizer.markers(scene.frame)
    missed = (cKDTree(found).query(scene.centres_px)[0] > within_px).sum()
    return int(missed), int((cKDTree(scene.centres_px).query(found)[0] > within_px).sum())


@pytest.fixture
def tactip():
    return Canonicalizer("tactip")


@pytest.fixture
def gelsight():
    return Canonicalizer("gelsight")


@pytest.mark.parametrize("rings, wrong", [(6, 1), (10, 3)])  # of 127 and 331 pins
@pytest.mark.parametrize("rim", ["none", "ring", "arcs", "bright outside"])
def test_dome_pins_are_all_found_and_the_rim_is_not(dome, tactip, rings, wrong, rim):
    assert max(missed_and_false(dome(rings=rings, rim=rim), tactip)) <= wrong


@pytest.mark.parametrize("size", [(320, 240), (1280, 960), (1920, 1080)])
def test_dome_of_any_size(dome, tactip, size):
    missed, false = missed_and_false(dome(rings=6, size=size), tactip)
    assert missed <= 2 and false <= 1


@pytest.mark.parametrize("rings", [6, 10])
def test_led_reflections_cost_only_the_pins_they_cover(dome, tactip, rings):
    missed, false = missed_and_false(dome(rings=rings, reflections=5), tactip)
    assert missed <= 10 and false <= 2  # each 22×12 px reflection covers one or two pins


def test_pressed_dome_moves_its_pins_outwards(dome, tactip):
    pressed = dome(pressed=True, seed=1)
    assert max(missed_and_false(pressed, tactip)) <= 3
    pair = tactip.pair(dome().frame, pressed.frame, finger="right")
    near = slice(190, 320), slice(300, 430)  # around the press
    assert pair.current[near].mean() < pair.reference[near].mean()


def test_dim_pins_beside_a_bright_rim(dome, tactip):
    assert max(missed_and_false(dome(brightness=80.0), tactip)) <= 6


GELS = {
    "80 squares": dict(),
    "25 squares": dict(grid=(5, 5)),
    "63 dots": dict(grid=(7, 9), shape="dot", size=(320, 240)),
    "266 dots": dict(grid=(14, 19), shape="dot"),
    "80 dashes": dict(shape="dash"),
    "64 bright dots": dict(grid=(8, 8), shape="dot", dark=False),
    "80 faint squares": dict(contrast=0.2, noise=3.0),
    "80 squares, noisy": dict(noise=12.0),
    "80 squares, wide": dict(size=(1280, 720)),
    "80 squares, upright": dict(size=(480, 640)),
}


@pytest.mark.parametrize("name", GELS)
def test_gel_markers_of_either_polarity(gel, gelsight, name):
    missed, false = missed_and_false(gel(**GELS[name]), gelsight)
    assert missed <= 1 and false <= 1


@pytest.mark.parametrize("name", ["80 squares", "266 dots", "80 dashes", "64 bright dots"])
def test_specular_streak_invents_nothing(gel, gelsight, name):
    missed, false = missed_and_false(gel(**GELS[name], streak=True), gelsight, 6.0)
    assert missed <= 5 and false <= 4  # the streak covers up to five markers and may split some


def test_mask_covers_the_markers(gel, gelsight):
    image = gelsight.marker_image(gel().frame)
    area = np.median(cv2.connectedComponentsWithStats(image)[2][1:, 4])
    side = 2 * 0.18 * (0.85 * 480 / 7)  # the gel's pitch and marker share
    assert 0.8 * side**2 < area < 1.9 * side**2  # grown by up to 2 px a side


def test_one_canonicalizer_serves_different_gels(gel, dome, gelsight):
    """A plan learnt from one frame must not spoil the next."""
    bright = gel(**GELS["64 bright dots"])
    for scene in (gel(), dome(rings=6, rim="none"), bright, gel()):
        assert max(missed_and_false(scene, gelsight)) <= 2


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((480, 640), np.uint8),
        np.zeros((480, 640, 4), np.uint8),
        np.full((480, 640, 3), 0.5, np.float32),
        np.zeros((480, 640, 3), np.int16),
        np.zeros((0, 640, 3), np.uint8),
        np.zeros((16, 16, 3), np.uint8),
        None,
        [[1, 2, 3]],
    ],
)
def test_malformed_frame_breaks_the_contract(gelsight, frame):
    with pytest.raises(ContractError, match="camera frame: expected"):
        gelsight.marker_image(frame)


@pytest.mark.parametrize("level", [0, 8, 128, 255])
def test_black_or_even_frame_is_refused(tactip, level):
    with pytest.raises(SensorError, match="camera frame: expected"):
        tactip.marker_image(np.full((480, 640, 3), level, np.uint8))


@pytest.mark.parametrize("seed, level, sigma", [(0, 3, 2), (1, 128, 4), (2, 128, 25), (3, 200, 60)])
def test_dark_noise_and_bright_noise_hold_no_markers(gelsight, seed, level, sigma):
    noise = np.random.default_rng(seed).normal(level, sigma, (480, 640, 3))
    with pytest.raises(SensorError):
        gelsight.marker_image(np.clip(noise, 0, 255).astype(np.uint8))


def test_gel_without_markers_is_refused(gel, gelsight):
    with pytest.raises(SensorError, match="markers on the gel"):
        gelsight.marker_image(gel(contrast=0.0, streak=True).frame)


def test_scattered_dirt_is_not_a_pattern(gel, gelsight):
    rng = np.random.default_rng(3)
    frame = gel(contrast=0.0).frame
    for *at, radius in rng.integers((20, 20, 2), (620, 460, 12), (60, 3)).tolist():
        cv2.circle(frame, at, radius, (20, 20, 20), cv2.FILLED)
    with pytest.raises(SensorError):
        gelsight.marker_image(frame)


def test_lights_out_during_a_pair(dome, tactip):
    frame = dome(rings=6).frame
    with pytest.raises(SensorError, match="all-black"):
        tactip.pair(frame, np.zeros_like(frame), finger="left")


def test_frames_of_two_sizes_are_no_pair(dome, tactip):
    small = dome(rings=6, size=(320, 240)).frame
    with pytest.raises(ContractError, match="one camera setting"):
        tactip.pair(dome(rings=6).frame, small, finger="left")


# --- real recordings ------------------------------------------------------------------------------


def read_rgb(path):
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


@pytest.mark.real
@pytest.mark.parametrize("index", range(6))
def test_fots_frames_have_108_markers(real_folder, gelsight, index):
    frame = read_rgb(real_folder / "gelsight_fots" / f"{index}.png")
    assert abs(len(gelsight.markers(frame)) - 108) <= 2


@pytest.mark.real
@pytest.mark.parametrize("name", ["1. raw(1280*720).png", "2. scale down(640*360).png"])
def test_bright_dots_match_the_authors_mask(real_folder, gelsight, name):
    folder = real_folder / "gelsight_bright_dots"
    frame = read_rgb(folder / name)
    theirs = read_rgb(folder / "3. mask.png")[..., 0] > 127  # (360, 640)
    ours = gelsight.marker_image(frame)[60:420] > 0
    assert len(gelsight.markers(frame)) == 64
    assert (ours & theirs).sum() / (ours | theirs).sum() >= 0.75


@pytest.mark.real
@pytest.mark.parametrize("sensor", ["gelsight", "tactip"])
def test_real_gels_without_markers_are_refused(real_folder, sensor):
    shown = (real_folder / "markerless_9dtact").rglob("*.png")
    dots = ("camera_calibration", "sample.png")  # pressed into that gel
    pictures = [path for path in shown if path.parts[-2:] != dots]
    assert len(pictures) == 4
    for path in pictures:
        with pytest.raises(SensorError, match="markers on the gel"):
            Canonicalizer(sensor).set_reference(read_rgb(path))
