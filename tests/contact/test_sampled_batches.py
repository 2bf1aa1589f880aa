"""Equilibrium pairs and force sequences: shapes, frames, balance, seeds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from benchmarks.probes.labelled_set import force_sequences
from uniforce_vtla.contact import (
    PAPER_RANGE,
    PRETRAIN,
    SEEN,
    ContactOptions,
    ForceRange,
    PairSettings,
    equilibrium_pairs,
)
from uniforce_vtla.contact.pads import cell_positions_mm
from uniforce_vtla.contact.sampling import (
    FLAT,
    FLAT_SIDE_mm,
    press_shear_release,
    sample_loads,
)
from uniforce_vtla.contact.wear import Creep, Light, lagging_force
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.sensors import list_sensors

DRAWING = PairSettings(unit_strength=0.0, options=ContactOptions().quiet())


def small(images):
    return images[:, ::6, ::6]


def pairs_of(n, left, right, seed=0, **more):
    return equilibrium_pairs(np.random.default_rng(seed), n, left, right, **more)


def test_pairs_have_their_shapes_and_names():
    pairs = pairs_of(5, "gelsight", "tactip")
    for finger in FINGERS:
        for name in ("reference", "current"):
            images = getattr(pairs, f"{finger}_{name}")
            assert images.shape == (5, 480, 640) and images.dtype == np.uint8
    assert pairs.force_N.shape == (5, 3) and pairs.torsion_Nmm.shape == (5,)
    assert set(pairs.indenters) <= {*PRETRAIN, FLAT}


def test_both_fingers_feel_the_mirrored_contact():
    pairs = pairs_of(6, "gelsight", "gelsight", settings=DRAWING)
    # mirrored contacts sum in another order: a marker's edge may move by a pixel
    assert (pairs.right_current != pairs.left_current[:, :, ::-1]).mean() < 1e-3
    assert not np.array_equal(pairs.right_current, pairs.left_current)


def test_pairs_repeat_with_the_seed():
    first, again = (pairs_of(3, "uskin", "tactip") for _ in range(2))
    np.testing.assert_array_equal(first.left_current, again.left_current)
    np.testing.assert_array_equal(first.right_reference, again.right_reference)


def test_units_change_within_a_call():
    settings = replace(DRAWING, unit_strength=1.0, pairs_per_unit=2)
    one, same, other, _ = pairs_of(4, "gelsight", "uskin", settings=settings).left_reference
    assert np.array_equal(one, same) and not np.array_equal(same, other)


def test_a_transform_is_applied_to_every_image():
    pairs = pairs_of(3, "uskin", "tactip", transform=small)
    assert pairs.left_current.shape == pairs.right_reference.shape == (3, 80, 107)


def test_loads_are_balanced_and_within_friction():
    limits = ForceRange()
    force, torsion = sample_loads(np.random.default_rng(5), 20_000, limits)
    shear = force[:, :2]
    length = np.hypot(*shear.T)
    fz = force[:, 2]
    assert (fz == 0).mean() == pytest.approx(0.06, abs=0.01)
    assert (fz > 12).mean() > 0.1 and fz.max() <= 16
    assert np.abs(shear).max() <= 8.001 and (np.abs(shear) > 5).any(axis=0).all()
    assert (length <= limits.friction * fz + 1e-4).all()
    assert np.abs(shear.mean(axis=0)).max() < 0.1
    assert 0.4 < (torsion != 0).mean() < 0.55 and abs(torsion.mean()) < 0.5
    assert (length > 0.8 * fz).mean() > 0.03  # incipient slip


def test_flat_faces_alone_may_be_twisted_further():
    """A held tool twists a flat pad by 9 mm of arm; the same draw without that option is what it
    always was."""

    def drawn(names=(FLAT, "ball") * 500, **limits):
        return sample_loads(np.random.default_rng(5), 1000, ForceRange(**limits), names)

    force, before = drawn()
    wide_force, after = drawn(flat_torsion_arm_mm=9.0)
    np.testing.assert_array_equal(force, wide_force)
    np.testing.assert_array_equal(before[1::2], after[1::2])
    np.testing.assert_allclose(after[::2], before[::2] * 9.0 / 2.5, rtol=1e-5)
    assert np.abs(after[::2]).max() > 60
    np.testing.assert_array_equal(before, drawn(names=())[1])


def face_gaps(n, **given):
    settings = PairSettings(flat_share=1.0, **given)
    return settings.objects(np.random.default_rng(8), n, PRETRAIN).gap_mm


def test_large_flat_faces_cover_the_pad():
    """A face that ends on the pad leaves cells beside it; one of 60 mm and more leaves none."""
    usual, large = (
        np.ptp(face_gaps(40, flat_side_mm=side), axis=(1, 2))
        for side in (FLAT_SIDE_mm, (60.0, 70.0))
    )
    assert (usual > 2).mean() > 0.3 and large.max() <= 2  # mm: tilt alone makes less


def test_faces_lean_as_far_as_asked():
    """The gap of a face over the whole grid differs by its lean times the grid between two opposite
    edges."""
    across_mm = np.ptp(cell_positions_mm()[:, 0])
    for lean in (0.0, 0.01, 0.03):
        gap = face_gaps(200, flat_side_mm=(60.0, 70.0), flat_tilt_rad=lean)
        edge = np.ptp(gap[:, gap.shape[1] // 2], axis=1)
        assert 0.9 * across_mm * lean <= edge.max() <= 1.001 * across_mm * lean


@pytest.mark.parametrize("sensor", list_sensors())
def test_sequences_start_and_end_in_free_air(sensor):
    batch = force_sequences(np.random.default_rng(6), sensor, n=3, length=12, transform=small)
    assert batch.frames.shape == (3, 12, 80, 107) and batch.reference.shape == (3, 80, 107)
    assert batch.force_N.shape == (3, 12, 3) and set(batch.indenters) <= set(SEEN)
    np.testing.assert_allclose(batch.force_N[:, [0, -1]], 0, atol=1e-5)
    moving = np.abs(batch.frames.astype(float) - batch.reference[:, None]).mean(axis=(2, 3))
    assert (moving.max(axis=1) > moving[:, 0]).all()


def test_sequences_cover_their_range_within_friction():
    rng = np.random.default_rng(7)
    force = np.concatenate([press_shear_release(rng, 20, PAPER_RANGE) for _ in range(400)])
    x, y, z = force.T
    assert 9 < z.max() < 13.5 and z.min() >= 0
    assert 2.5 < np.abs(x).max() <= 3.001 and 2.5 < np.abs(y).max() <= 3.001
    assert (np.hypot(x, y) <= z + 1e-4).all()


@given(st.floats(0.0, 0.3), st.floats(0.2, 2.0))
@example(0.0, 1.0)
def test_creep_lags_and_settles(share, tau):
    force = np.concatenate([np.zeros((5, 3)), np.ones((200, 3))]).astype(np.float32)
    lagging = lagging_force(force, Creep(share, tau), rate_hz=10.0)
    assert np.all(lagging <= 1 + 1e-6) and np.all(np.diff(lagging, axis=0) >= -1e-6)
    assert np.allclose(lagging[5], 1 - share * np.exp(-1 / (tau * 10)), atol=1e-5)
    assert np.allclose(lagging[-1], 1, atol=1e-3)


def test_light_scales_channels_and_leans_to_one_side():
    frames = np.full((1, 480, 640, 3), 100, np.uint8)
    lit = Light((1.0, 0.5, 1.0), (0.2, 0.0)).on(frames)[0].astype(float)
    np.testing.assert_allclose(lit[240, 320, :2], [100, 50], atol=1)
    assert lit[240, -1, 0] > lit[240, 0, 0] + 30


def test_perfect_pairs_by_default_and_disturbed_ones_on_request():
    usual = PairSettings(unit_strength=0.0, flat_share=0.0)
    plain = pairs_of(6, "gelsight", "tactip", settings=usual)
    for disturbed in ({"misaligned_cells": 2}, {"imbalance": 0.3}):
        other = pairs_of(6, "gelsight", "tactip", settings=replace(usual, **disturbed))
        assert np.array_equal(plain.left_current, other.left_current)
        assert not np.array_equal(plain.right_current, other.right_current)
        assert np.array_equal(plain.force_N, other.force_N)
