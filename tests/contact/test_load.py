"""Pressure and traction: forces are conserved, depth follows force, friction caps."""

from dataclasses import replace
from functools import cache

import contact_samples
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.contact import (
    ContactOptions,
    TactileSimulator,
    gap_map,
    pressure,
)
from uniforce_vtla.contact.indenters import HEIGHTS
from uniforce_vtla.contact.simulator import free_air
from uniforce_vtla.contact.traction import CellSkin, solve_traction
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.sensors import get_sensor, list_sensors

SENSORS = list_sensors()
names, sensors = st.sampled_from(sorted(HEIGHTS)), st.sampled_from(SENSORS)
place = st.tuples(st.floats(-5, 5), st.floats(-5, 5))


@cache
def simulator(sensor):
    return TactileSimulator(sensor, options=ContactOptions().quiet())


def pressed(name, *force_N, torsion=0.0, center=(0, 0), angle=0.0):
    n = len(force_N)
    gap = np.repeat(gap_map(name, center, angle)[None], n, axis=0)
    return ContactState(gap, np.array(force_N, np.float32), np.full(n, torsion, np.float32))


def faces(*fz_N):
    """Return presses of a flat face larger than any pad."""
    return contact_samples.faces([(0, 0, fz) for fz in fz_N], side_mm=60.0)


@examples(60)
@given(
    sensors,
    names,
    place,
    st.floats(0, 3.2),
    st.floats(0.05, 16),
    st.floats(0, 0.9),
    st.floats(-3.14, 3.14),
)
def test_force_is_conserved(sensor, name, center, angle, fz, share, way):
    force_N = share * fz * np.cos(way), share * fz * np.sin(way), fz
    contact = pressed(name, force_N, center=center, angle=angle)
    carried, moment = simulator(sensor).carried(contact)
    np.testing.assert_allclose(carried[0], force_N, atol=0.004 * fz)
    assert abs(moment[0]) < 0.01 + 0.015 * fz


@examples(40)
@given(sensors, names, place, st.lists(st.floats(0, 16), min_size=2, max_size=6))
@example("gelsight", "cone", (0.0, 0.0), [1e-7, 1.0000001e-7])  # fell by up to 20 µm below 1e-7 N
@example("tactip", "torus", (0.0, 0.0), [3.9e-10, 1.6e-9])
@example("uskin", "pacman", (0.0, 0.0), [4.0e-10, 1.8e-9])
@example("uskin", "moon", (0.0, 0.0), [0.0, 5e-324, 1e-44, 1e-38, 1e-30, 16.0])
def test_depth_grows_with_force(sensor, name, center, loads):
    fz = np.sort(loads)
    contact = pressed(name, *[(0, 0, load) for load in fz], center=center)
    depth = simulator(sensor).depth_mm(contact)
    rounding = 1e-6 * depth[1:] + np.finfo(np.float32).tiny
    assert (np.diff(depth) >= -rounding).all() and (depth[fz == 0] == 0).all()
    assert (np.diff(depth)[np.diff(fz) > 0.1] > 0).all()


@examples(40)
@given(sensors, names, st.floats(0, 30), st.floats(-200, 200), st.floats(0.5, 16))
def test_no_cell_exceeds_friction(sensor, name, shear, torsion, fz):
    contact = pressed(name, (shear, 0, fz), torsion=torsion)
    traction = simulator(sensor).traction(contact)
    assert (np.hypot(*traction.shear_N[0]) <= traction.press_N[0] * 1.001 + 1e-7).all()
    carried, _ = simulator(sensor).carried(contact)
    assert np.hypot(*carried[0, :2]) <= fz * 1.002


def test_partial_slip_hands_load_to_sticking_cells():
    """Torsion and shear that slip on one side only are still carried as a whole."""
    pad = simulator("gelsight").pad
    position = pad.position_mm
    skin = CellSkin.of(pad.influence.skin, np.arange(len(position)))
    p = np.exp(-(position**2).sum(axis=1, keepdims=True).T / 30).astype(np.float32)
    total = float(p.sum())
    shear = np.array([[0.45 * total, 0.0]])
    torsion = np.array([2.0 * total])
    free, capped = (
        solve_traction(p, position, skin, shear, torsion, friction) for friction in (1e6, 1.0)
    )
    assert (np.hypot(*free[0]) > p[0] * 1.01).any() and (np.hypot(*capped[0]) <= p[0] * 1.001).all()
    np.testing.assert_allclose(capped.sum(axis=2), shear, rtol=0.03, atol=0.03 * total)
    moment = (position[:, 0] * capped[0, 1] - position[:, 1] * capped[0, 0]).sum()
    assert moment == pytest.approx(torsion[0], rel=0.05)


def test_gross_slip_carries_friction_times_pressure():
    carried, _ = simulator("gelsight").carried(contact_samples.sphere(9.0, 0, 4.0))
    assert carried[0, 0] == pytest.approx(4.0, rel=1e-2)


def test_flat_tools_press_pads_as_stiffly_as_measured_ones():
    """Real TacTips give 3.3 to 4.7 N/mm; a bonded gel under a whole face hardly yields."""
    dome = simulator("tactip").depth_mm(faces(3, 6))
    gel = simulator("gelsight").depth_mm(faces(3, 6))
    assert 3.0 < 3 / (dome[1] - dome[0]) < 5.0
    assert gel[1] < 0.3


@pytest.mark.parametrize("sensor", SENSORS)
def test_typical_indenters_stay_within_twice_the_rated_depth(sensor):
    depth = [simulator(sensor).depth_mm(pressed(name, (0, 0, 12.0))) for name in HEIGHTS]
    rated = get_sensor(sensor).rated_depth_mm
    assert 0.4 * rated < np.median(depth) < 2 * rated


def test_friction_holds_the_gel_that_a_press_would_push_aside():
    state = pressed("cylinder", (0, 0, 8.0))
    under = np.hypot(*get_sensor("gelsight").layout_mm.T) < 4

    def motion_px(friction):
        options = replace(ContactOptions().quiet(), friction=friction)
        gel = TactileSimulator("gelsight", options=options)
        moved = gel.markers_px(state)[0][0] - gel.markers_px(free_air(1))[0][0]
        return np.hypot(*moved[under].T).mean()

    assert motion_px(1.0) < 0.7 * motion_px(1e-6)


def test_a_solved_contact_stays_solved_while_its_batch_goes_on(monkeypatch):
    monkeypatch.setattr(pressure, "_TOLERANCE", -1.0)
    rng = np.random.default_rng(0)
    for cells in [2, 3, 4, 5, 6] * 5:
        half = rng.standard_normal((cells, cells + 1)).astype(np.float32)
        gap = 1e-3 * np.abs(rng.standard_normal((8, cells))).astype(np.float32)
        even = np.full_like(gap, 1 / cells)
        share, _ = pressure.share_load(0.1 * half @ half.T, gap, even, steps=200)
        assert share.min() >= 0
        np.testing.assert_allclose(share.sum(axis=1), 1, atol=1e-5)


def test_dome_widens_its_contact_with_load():
    cells = (simulator("tactip").traction(faces(1, 8)).press_N > 0).sum(axis=1)
    assert cells[1] > 2 * cells[0]
