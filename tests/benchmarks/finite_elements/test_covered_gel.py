"""A covered gel's elements against closed forms, and its measures against known motion."""

import math

import numpy as np
import pytest

from benchmarks.finite_elements.covered_gel import (
    GELSIGHT,
    SimulatedGrip,
    dilation_noise_percent,
    dilation_percent,
    seen_mm,
    with_friction,
)
from benchmarks.finite_elements.covered_slab import Face, PressedSlab, Slab
from uniforce_vtla.contracts import ContactState


@pytest.mark.parametrize("face", ["sliding", "sticking"])
def test_fixed_walls_leave_uniaxial_strain(face: Face) -> None:
    pressed = PressedSlab(GELSIGHT.slab, face, (False, False), (3, 2))
    moved = pressed.motion(GELSIGHT.layout_mm, 1.0)
    assert pressed.stiffness_N_per_mm == pytest.approx(GELSIGHT.slab.uniaxial_stiffness)
    np.testing.assert_allclose(moved[:, :2], 0, atol=1e-9)
    np.testing.assert_allclose(moved[:, 2], 0.75 / pressed.stiffness_N_per_mm)


def test_a_long_bonded_strip_is_as_stiff_as_theory_says() -> None:
    """Kelly, Earthquake-Resistant Design with Rubber, 1993: it bulges at its long walls alone."""
    slab = Slab((25.0, 25.0), 2.0, 1.0, 0.499)
    pressed = PressedSlab(slab, "sticking", (True, False))
    bulk_MPa = 1 / (3 * (1 - 2 * slab.poisson))
    shear_MPa = 1 / (2 * (1 + slab.poisson))
    decay = math.sqrt(12 * shear_MPa / bulk_MPa) * (slab.size_mm[0] / 2) / slab.thickness_mm
    # bulging under pressure that no wall holds, and plane strain
    modulus_MPa = bulk_MPa * (1 - math.tanh(decay) / decay) + 4 * shear_MPa
    found_MPa = pressed.stiffness_N_per_mm * slab.thickness_mm / (slab.size_mm[0] * slab.size_mm[1])
    assert found_MPa == pytest.approx(modulus_MPa, rel=0.02)


def test_finer_elements_and_the_simulators_own_agree() -> None:
    """Gel that sticks to the plate up to its rim, where friction of 100 is still overcome."""
    finer = PressedSlab(GELSIGHT.slab, "sticking", (True, True), (8, 6))
    usual = PressedSlab(GELSIGHT.slab, "sticking", (True, True))
    own = with_friction(GELSIGHT, 100.0)
    moved = usual.motion(GELSIGHT.layout_mm, GELSIGHT.readout_mm)
    slope = float(dilation_percent(GELSIGHT.layout_mm, seen_mm(GELSIGHT.layout_mm, moved, 30.0)))
    assert usual.stiffness_N_per_mm == pytest.approx(finer.stiffness_N_per_mm, rel=0.01)
    assert own["stiffness_N_per_mm"] == pytest.approx(usual.stiffness_N_per_mm, rel=0.04)
    assert own["dilation_percent_per_N"] == pytest.approx(slope, rel=0.05)


def test_dilation_is_the_growth_of_area_and_its_noise_that_of_a_fit() -> None:
    layout_mm = GELSIGHT.layout_mm
    assert dilation_percent(layout_mm, 0.01 * layout_mm + 0.3) == pytest.approx(2, rel=1e-4)
    scatter_mm = 0.02 * np.random.default_rng(0).standard_normal((2000, *layout_mm.shape))
    found = dilation_percent(layout_mm, scatter_mm).std()
    assert dilation_noise_percent(layout_mm, 0.02) == pytest.approx(found, rel=0.05)


def test_the_simulated_pad_has_free_walls() -> None:
    """It dilates as finite elements with friction do, five times as much as with fixed walls."""
    fast = SimulatedGrip()
    face = ContactState(np.zeros((1, 32, 32)), np.array([[0.0, 0.0, 10.0]]), np.zeros(1))
    moved = fast.motion_mm(face)
    wanted = with_friction(GELSIGHT, 1.0)["loads"]["10 N"]["dilation_percent"]
    assert float(dilation_percent(fast.layout_mm, moved)[0]) == pytest.approx(wanted, rel=0.15)
