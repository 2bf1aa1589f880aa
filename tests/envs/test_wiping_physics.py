"""The scene's physics, by the numbers a laboratory would ask for before trusting it."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.physics_rig import (
    GRAVITY_m_s2,
    creep_mm_s,
    grasped,
    hold,
    pressed,
    residual_after,
    slip_load,
    squeeze,
    stroke,
    warnings,
)
from lerobot_env_uniforce_wiping.levels import PadSettings
from lerobot_env_uniforce_wiping.mjcf import SolverSettings
from uniforce_vtla.contracts import FINGERS

PADS = PadSettings()
few = settings(max_examples=8, deadline=None)  # each is a grasp of a tenth of a second and more


@few
@given(
    width_m=st.floats(0.017, 0.026),
    mass_kg=st.floats(0.03, 0.12),
    gel=st.tuples(st.floats(0.9, 1.1), st.floats(0.9, 1.1)),
)
def test_indentation_is_force_over_stiffness_and_both_pads_carry_the_same(width_m, mass_kg, gel):
    found = squeeze(width_m, eraser_mass_kg=mass_kg, stiffness=gel)
    rows = zip(*found, (PADS.flat_N_mm, PADS.dome_N_mm), gel, strict=True)
    for force_N, depth_mm, nominal, scale in rows:
        assert force_N > 1
        assert depth_mm == pytest.approx(force_N / (nominal * scale), rel=0.01)
    left_N, right_N = found[0]
    assert left_N == pytest.approx(right_N, rel=0.02)


@few
@given(friction=st.floats(0.3, 0.8), width_m=st.floats(0.018, 0.024))
def test_slip_load_is_two_mu_grip(friction, width_m):
    found = slip_load(friction, width_m)
    assert found["measured_N"] == pytest.approx(found["coulomb_N"], rel=0.05)


@pytest.mark.parametrize("friction", [0.3, 0.6, 0.8])
def test_below_the_slip_load_nothing_creeps(friction):
    assert abs(creep_mm_s(0.8, friction)) < 0.01


@pytest.mark.parametrize("depth_m, residual", [(0.008, 0.08), (0.012, 0.03), (0.014, 0.03)])
def test_finer_time_steps_change_nothing_that_matters(depth_m, residual):
    """480, 960 and 1920 Hz agree, also at the light press where a newton decides about the ink."""
    strokes = [stroke(depth_m, SolverSettings(substeps=n)) for n in (4, 8, 16)]
    for a, b in itertools.combinations(strokes, 2):
        assert a.press_N == pytest.approx(b.press_N, abs=0.12)
        assert a.residual == pytest.approx(b.residual, abs=residual)


def test_half_the_rate_is_too_coarse():
    """Why the time step is what it is: a setting that looks twice as fast gives another force."""
    coarse = stroke(0.012, SolverSettings(substeps=2))
    shipped = stroke(0.012)
    assert abs(coarse.press_N - shipped.press_N) > 0.5


@few
@given(press_N=st.floats(0.5, 9.0), more_N=st.floats(0.3, 3.0), seed=st.integers(0, 200))
def test_more_press_never_leaves_more_ink(press_N, more_N, seed):
    assert residual_after(press_N + more_N, seed=seed) <= residual_after(press_N, seed=seed)


def test_the_good_window_lies_between_light_and_excess():
    """A fifth of the limit leaves the word, the limit itself wipes it: touch decides in between."""
    assert residual_after(0.0) == 1.0 and residual_after(2.0) > 0.5 > 0.1 > residual_after(8.0)


def test_physics_runs_faster_than_real_time():
    assert stroke(0.010).times_real_time > 2  # CPU time of one core; some twelve on a quiet laptop


def test_pressing_on_the_board_pushes_both_pads_up_and_right_amount():
    sim = pressed(0.008)
    weight = sim.scene.eraser_mass_kg * GRAVITY_m_s2
    up = {f: sim.pads[f].wrench[1] for f in FINGERS}
    assert sim.press_N > 3
    assert sim.pads["left"].wrench[2] == pytest.approx(sim.pads["right"].wrench[2], rel=0.08)
    assert up["left"] < 0 and up["right"] < 0  # the contract: canonical fy < 0 on both
    assert -(up["left"] + up["right"]) == pytest.approx(sim.press_N - weight, abs=0.5)


def test_dragging_along_y_shears_both_pads_backwards():
    sim = pressed(0.008)
    x, y, z, yaw, width = sim.target
    hold(sim, [x, y + 0.05, z, yaw, width], 12)
    # canonical fx against the motion, same sign
    assert all(sim.pads[f].wrench[0] < -0.2 for f in FINGERS)


def test_leash_bounds_the_force_of_any_command():
    sim = pressed(0.0)
    x, y = sim.measured[:2]
    hold(sim, [x, y, -1.0, 0.0, 0.022], 60)
    assert sim.press_N < 800 * 0.018 * 1.15


def test_same_scene_same_trajectory():
    first = grasped()
    second = grasped()
    assert np.array_equal(first.data.qpos, second.data.qpos)
    assert warnings(first) == 0
