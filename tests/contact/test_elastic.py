"""Finite elements of pads: mirrored, reciprocal, as stiff as theory says, kept in a cache."""

from dataclasses import replace
from functools import cache
from unittest.mock import MagicMock

import numpy as np
import pytest

from uniforce_vtla.contact import elastic
from uniforce_vtla.contact.elastic import Gel, cell_edges, compute_influence, influence
from uniforce_vtla.sensors.material import Layer

SMALL = Gel((8.0, 6.5), (Layer(2.0, 1.0),), readout_mm=0.5)
DOME = Gel(
    (12.0, 12.0),
    (Layer(1.0, 0.4), Layer(4.0, 0.1, 0.3)),
    readout_mm=1.0,
    dome_radius_mm=20.0,
    cell_mm=1.5,
)


@cache
def solved(gel):
    return compute_influence(gel, progress=False)


@pytest.mark.parametrize("gel", [SMALL, DOME])
def test_compliance_is_reciprocal_and_positive(gel):
    skin = solved(gel).skin
    square = skin.reshape(3 * skin.shape[1], -1).astype(float)
    np.testing.assert_allclose(square, square.T, atol=2e-6 * np.abs(square).max())
    assert np.linalg.eigvalsh(square).min() > -1e-6 * np.abs(square).max()


def test_a_load_in_the_middle_moves_both_sides_alike():
    u = solved(SMALL).inside[:, :, :, 2].sum(axis=-1)  # under an even pressure, (3, rows, columns)
    np.testing.assert_allclose(u[0], -u[0][:, ::-1], atol=1e-6)
    np.testing.assert_allclose(u[1], -u[1][::-1], atol=1e-6)
    np.testing.assert_allclose(u[2], u[2][::-1, ::-1], atol=1e-6)


def test_twice_the_modulus_moves_half_as_far():
    stiff = solved(replace(SMALL, layers=(Layer(2.0, 2.0),)))
    np.testing.assert_allclose(solved(SMALL).skin, 2 * stiff.skin, rtol=1e-3, atol=1e-6)


def test_a_thin_wide_layer_is_as_stiff_as_uniaxial_strain():
    poisson = 0.3
    thickness = 0.5
    skin = solved(Gel((10.0, 10.0), (Layer(thickness, 1.0, poisson),), readout_mm=0.25)).skin
    amid = skin.shape[1] // 2 + 5
    moved = skin[2, amid, 2].sum()  # under 1 MPa on cells of 1 mm²
    modulus = (1 - poisson) / (1 + poisson) / (1 - 2 * poisson)
    assert moved == pytest.approx(thickness / modulus, rel=0.03)


def test_cells_cover_the_length_and_what_is_left_stands_at_both_ends():
    edges = cell_edges(24.6, 1.25)
    assert edges[0] == -12.3 and edges[-1] == 12.3
    widths = np.diff(edges)
    np.testing.assert_allclose(widths[1:-1], 1.25)
    assert widths[0] == pytest.approx(widths[-1]) == pytest.approx(1.05)
    assert len(cell_edges(25.0, 1.25)) == 21


@pytest.fixture
def nothing_remembered():
    influence.cache_clear()
    yield
    influence.cache_clear()


@pytest.mark.usefixtures("nothing_remembered")
def test_matrices_are_computed_once_and_read_afterwards(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = influence(SMALL)
    influence.cache_clear()
    monkeypatch.setattr(elastic, "compute_influence", lambda *_: pytest.fail("computed again"))
    again = influence(SMALL)
    np.testing.assert_array_equal(first.skin, again.skin)
    assert len(list(tmp_path.rglob("*.npz"))) == 1


@pytest.mark.usefixtures("nothing_remembered")
def test_a_damaged_file_of_the_cache_is_made_anew(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = influence(SMALL)
    influence.cache_clear()
    (file,) = tmp_path.rglob("*.npz")
    file.write_bytes(file.read_bytes()[:1000])
    np.testing.assert_array_equal(influence(SMALL).skin, first.skin)
    assert "made anew" in caplog.text
    influence.cache_clear()
    monkeypatch.setattr(elastic, "compute_influence", lambda *_: pytest.fail("computed again"))
    influence(SMALL)


@pytest.mark.usefixtures("nothing_remembered")
@pytest.mark.parametrize("why", ["no home", "not ours"])
def test_a_cache_that_cannot_be_used_costs_time_only(why, tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nothing" if why == "no home" else str(tmp_path))
    first = influence(SMALL)
    influence.cache_clear()
    if why == "not ours":
        refused = MagicMock(side_effect=PermissionError(13, "Permission denied"))
        monkeypatch.setattr(np, "load", refused)
    np.testing.assert_array_equal(influence(SMALL).skin, first.skin)
    assert "XDG_CACHE_HOME" in caplog.text
