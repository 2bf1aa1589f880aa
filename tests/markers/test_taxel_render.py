"""Taxels: the rendering follows its published scales, saturates visibly and refuses what isn't
counts."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from properties import examples

from uniforce_vtla.errors import ContractError, SensorError
from uniforce_vtla.markers import Canonicalizer, TaxelScales
from uniforce_vtla.markers.taxel_render import draw_discs, place_discs
from uniforce_vtla.sensors import get_sensor

BASELINE = np.random.default_rng(0).integers(15_000, 38_000, (16, 3))


@pytest.fixture
def canon():
    canon = Canonicalizer("uskin")
    canon.set_reference(BASELINE)
    return canon


def loaded(taxel, x=0, y=0, z=0):
    counts = BASELINE.copy()
    counts[taxel] += (x, y, z)
    return counts


def area(image):
    return (image > 0).sum()


def test_rest_is_sixteen_small_discs(canon):
    image = canon.marker_image(BASELINE)
    count, _, boxes, centres = cv2.connectedComponentsWithStats(image)
    assert image.shape == (480, 640) and set(np.unique(image)) == {0, 255}
    assert count == 17
    assert np.all(np.abs(boxes[1:, 4] - np.pi * (13.9 / 2) ** 2) < 20)
    # bottom row first, left to right
    order = np.lexsort((centres[1:, 0].round(), -centres[1:, 1].round()))
    assert np.allclose(centres[1:][order], canon.markers(BASELINE), atol=0.5)


def test_taxels_count_from_the_bottom_left_upwards(canon):
    centres = canon.markers(BASELINE)
    assert np.allclose(centres[0], (127.5, 383.5)) and np.allclose(centres[1], (255.5, 383.5))
    assert np.allclose(centres[4], (127.5, 287.5)) and np.allclose(centres[15], (511.5, 95.5))


@pytest.mark.parametrize(
    "x, y, moved", [(1000, 0, (64, 0)), (0, 1000, (0, -48)), (-1000, -1000, (-64, 48))]
)
def test_shear_moves_right_and_up(canon, x, y, moved):
    moved_px = canon.markers(loaded(5, x, y)) - canon.markers(BASELINE)
    assert np.allclose(moved_px[5], moved, atol=0.1)


@pytest.mark.parametrize(
    "z, diameter_px", [(0, 13.9), (900, 43.9), (3500, 83.3), (5900, 107.6), (20_000, 107.6)]
)
def test_pressure_grows_the_disc_by_its_law(canon, z, diameter_px):
    grown = area(canon.marker_image(loaded(5, z=z))) - area(canon.marker_image(BASELINE)) * 15 / 16
    assert 2 * np.sqrt(grown / np.pi) == pytest.approx(diameter_px, abs=1.0)


def test_pulling_leaves_the_smallest_disc(canon):
    assert np.array_equal(canon.marker_image(loaded(3, z=-200)), canon.marker_image(BASELINE))


@examples(60)
@given(hnp.arrays(np.int64, (16, 3), elements=st.integers(-40_000, 40_000)))
def test_any_counts_give_a_binary_image_inside_the_canvas(delta):
    discs = place_discs(delta, get_sensor("uskin"), TaxelScales())
    image = draw_discs(discs)
    assert set(np.unique(image)) <= {0, 255} and image.any()
    assert np.all((discs.centres_px > 0) & (discs.centres_px < (640, 480)))


@examples(30)
@given(hnp.arrays(np.int64, (16, 3), elements=st.integers(0, 3_000)), st.integers(-10_000, 10_000))
def test_only_the_difference_to_the_reference_matters(delta, shift):
    pair, other = (
        Canonicalizer("uskin").pair(baseline, baseline + delta, finger="left")
        for baseline in (BASELINE, BASELINE + shift)
    )
    assert np.array_equal(pair.current, other.current)
    assert np.array_equal(pair.reference, other.reference)


def test_unsigned_counts_do_not_wrap(canon):
    below = BASELINE.astype(np.uint16)
    below[4, 0] -= 500
    assert canon.markers(below)[4, 0] < canon.markers(BASELINE)[4, 0]


def test_scales_are_used(canon):
    other = Canonicalizer("uskin", taxel_scales=TaxelScales(counts_per_pitch=5_000.0))
    other.set_reference(BASELINE)
    sheared = loaded(5, x=1_000)
    assert not np.array_equal(canon.marker_image(sheared), other.marker_image(sheared))


OTHER_SHAPES = [BASELINE.reshape(4, 4, 3), BASELINE[1:], BASELINE.ravel(), BASELINE[:0]]
OTHER_NUMBERS = [BASELINE.astype(np.float32), BASELINE.astype(bool), None, BASELINE.tolist()]


@pytest.mark.parametrize("counts", [*OTHER_SHAPES, *OTHER_NUMBERS])
def test_malformed_counts_break_the_contract(canon, counts):
    for call in (canon.marker_image, canon.markers, canon.set_reference):
        with pytest.raises(ContractError, match="expected integers"):
            call(counts)
    with pytest.raises(ContractError):
        canon.pair(BASELINE, counts, finger="left")


def test_rendering_needs_a_reference():
    for call in (Canonicalizer("uskin").marker_image, Canonicalizer("uskin").markers):
        with pytest.raises(ContractError, match="set_reference"):
            call(BASELINE)


def test_dead_sensor(canon):
    dead = 0 * BASELINE
    with pytest.raises(SensorError, match="48 zeros"):
        canon.marker_image(dead)
    with pytest.raises(SensorError, match="48 zeros"):
        canon.pair(BASELINE, dead, finger="left")
    with pytest.raises(SensorError, match="reference: expected a live scan"):
        canon.pair(dead, BASELINE, finger="left")


def test_a_tared_stream_has_noise_in_its_reference(canon):
    noise = np.eye(16, 3, dtype=np.int64)
    pressed = loaded(5, 100, 100, 900)
    pair = canon.pair(noise, pressed - BASELINE + noise, finger="left")
    assert np.array_equal(pair.current, canon.marker_image(pressed))
