"""Indenters, flat faces and the rasteriser."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.contact import PRETRAIN, SEEN, UNSEEN, flat_face_gap, gap_map, gap_maps
from uniforce_vtla.contact.indenters import HEIGHTS
from uniforce_vtla.errors import ContractError
from uniforce_vtla.markers.raster import fill_discs, fill_squares


def test_split_is_the_papers():
    assert len(HEIGHTS) == 18 and len(SEEN) == 12 and len(UNSEEN) == 6 and len(PRETRAIN) == 8
    assert set(SEEN) | set(UNSEEN) == set(HEIGHTS) and not set(SEEN) & set(UNSEEN)
    assert set(PRETRAIN) <= set(SEEN)


@pytest.mark.parametrize("name", sorted(HEIGHTS))
def test_every_indenter_touches_at_zero_and_is_finite_somewhere(name):
    gap = gap_map(name, (1.5, -2.0), 0.4)
    assert gap.shape == (32, 32) and gap.dtype == np.float32
    assert gap.min() == 0 and 8 <= np.isfinite(gap).sum() < 520 and not np.isnan(gap).any()


def test_all_shapes_differ():
    gaps = gap_maps(list(HEIGHTS), np.zeros((18, 2)), np.zeros(18), np.ones(18))
    filled = np.where(np.isfinite(gaps), gaps, 50).reshape(18, -1)
    apart = np.abs(filled[:, None] - filled[None]).max(axis=-1)
    assert (apart + np.eye(18) > 0.2).all()


def test_batch_of_gaps_equals_singles():
    rng = np.random.default_rng(0)
    center = rng.uniform(-4, 4, (18, 2))
    angle = rng.uniform(-3, 3, 18)
    scale = rng.uniform(0.8, 1.2, 18)
    batched = gap_maps(list(HEIGHTS), center, angle, scale)
    singles = list(map(gap_map, HEIGHTS, center, angle, scale))
    np.testing.assert_array_equal(batched, singles)


def test_center_moves_the_object_right_and_down():
    rows, columns = np.nonzero(gap_map("sphere", (6.875, 3.125), 0.0) == 0)
    assert columns.mean() == pytest.approx(15.5 + 5.5) and rows.mean() == pytest.approx(15.5 + 2.5)


def test_angle_turns_x_towards_y():
    gap = gap_map("line", (0, 0), np.pi / 4)
    rows, columns = np.nonzero(np.isfinite(gap))
    assert np.corrcoef(columns, rows)[0, 1] > 0.8


def test_flat_face_covers_its_rectangle_and_tilts():
    centers_mm = np.array([[0.0, 0.0], [90.0, 90.0]])
    sides_mm = np.array([[20.0, 10.0]] * 2)
    gap, away = flat_face_gap(centers_mm, sides_mm, np.zeros(2), np.array([[0.05, 0.0]] * 2))
    assert np.isfinite(gap).sum() == 128  # cells of 1.25 mm
    assert gap[16, 23] > gap[16, 8] == 0
    assert np.isinf(away).all()


def test_unknown_indenter_is_refused():
    with pytest.raises(ContractError, match="sphere"):
        gap_map("banana", (0, 0), 0.0)


@examples(40)
@given(
    st.floats(-60, 700), st.floats(-60, 540), st.floats(1, 110), st.sampled_from(["disc", "square"])
)
def test_filled_area_is_right_and_clipped(x, y, size, shape):
    fill = fill_discs if shape == "disc" else fill_squares
    image = fill(np.array([[[x, y]]]), np.array([[size]]))[0]
    assert image.shape == (480, 640) and set(np.unique(image)) <= {0, 255}
    full = np.pi * size**2 / 4 if shape == "disc" else size**2
    count = np.count_nonzero(image)
    assert count <= full + 4 * size + 4
    if size / 2 + 1 < x < 638 - size / 2 and size / 2 + 1 < y < 478 - size / 2:
        assert abs(count - full) <= 2.5 * size + 4


def test_a_turned_square_keeps_its_area_and_gains_reach():
    turned = fill_squares(np.full((1, 1, 2), 100.0), np.full((1, 1), 40.0), np.pi / 4)[0]
    assert abs(np.count_nonzero(turned) - 1600) < 60
    assert np.ptp(np.nonzero(turned), axis=1).min() > 1.3 * 40


def test_overlapping_shapes_stay_filled():
    image = fill_discs(np.array([[[100.0, 100.0], [106.0, 100.0]]]), np.array([[20.0, 20.0]]))[0]
    assert image[100, 95:112].all()
