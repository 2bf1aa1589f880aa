"""What a lens shows of a millimetre is taken out: the same gel behind two lenses looks the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.virtual import as_virtual
from uniforce_vtla.markers.canonicalizer import Canonicalizer
from uniforce_vtla.markers.nominal_scale import (
    is_nominal,
    nominal_zoom,
    points_to_nominal_scale,
    to_nominal_scale,
)
from uniforce_vtla.sensors import get_sensor, list_sensors


@pytest.mark.parametrize("name", list_sensors())
def test_the_known_sensors_stay_as_they_are(name: str) -> None:
    image = np.random.default_rng(0).choice([0, 255], (480, 640)).astype(np.uint8)
    spec = get_sensor(name)
    assert is_nominal(spec) and to_nominal_scale(image, spec) is image


@pytest.mark.parametrize(("name", "px_per_mm"), [("gelsight", 15.0), ("gelsight", 30.0), ("tactip", 14.0)])
def test_another_lens_over_the_same_gel_looks_nominal(name: str, px_per_mm: float) -> None:
    nominal = as_virtual(name)
    spec = replace(nominal.spec, px_per_mm=(px_per_mm, px_per_mm))
    other = TactileSimulator(replace(nominal, spec=spec), seed=0).reference()
    brought, wanted = to_nominal_scale(other, spec), TactileSimulator(nominal, seed=0).reference()
    assert set(np.unique(brought)) == {0, 255}
    inner = (slice(100, 380), slice(140, 500))  # what a near lens cut away can't come back
    both = np.logical_and(brought[inner] > 0, wanted[inner] > 0).sum()
    either = np.logical_or(brought[inner] > 0, wanted[inner] > 0).sum()
    assert both / either > 0.75
    before = np.logical_and(other[inner] > 0, wanted[inner] > 0).sum()
    assert both > 1.5 * before


@examples(30)
@given(zoom=st.floats(0.6, 1.7), x=st.integers(250, 390), y=st.integers(180, 300), taxel=st.booleans())
def test_a_marker_goes_where_its_point_goes(zoom: float, x: int, y: int, taxel: bool) -> None:
    base = get_sensor("uskin" if taxel else "gelsight")
    spec = replace(base, px_per_mm=(24.0 / zoom, 24.0 / zoom))
    image = np.zeros((480, 640), np.uint8)
    image[y - 6 : y + 7, x - 6 : x + 7] = 255
    rows, columns = np.nonzero(to_nominal_scale(image[None], spec)[0])
    point = points_to_nominal_scale(np.array([[x, y]], np.float32), spec, (480, 640))[0]
    assert np.allclose([columns.mean(), rows.mean()], point, atol=1.0)
    assert nominal_zoom(spec) == ((1.0, 1.0) if taxel else pytest.approx((zoom, zoom)))


def test_the_canonicaliser_brings_a_new_cameras_images_to_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = TactileSimulator("gelsight", seed=0)
    raw = simulator.raw_reference()
    plain = Canonicalizer("gelsight")
    zoomed = Canonicalizer("gelsight")
    zoomed.spec = replace(zoomed.spec, px_per_mm=(20.0, 20.0))  # as a registry entry with another lens would
    image, again = plain.marker_image(raw), zoomed.marker_image(raw)
    assert np.array_equal(again, to_nominal_scale(image, zoomed.spec)) and not np.array_equal(image, again)
    pair = zoomed.pair(raw, raw, "left")
    assert np.array_equal(pair.reference, again) and np.array_equal(pair.current, again)
    spread = [np.ptp(c.markers(raw), axis=0) for c in (plain, zoomed)]
    assert np.allclose(spread[1] / spread[0], 1.2, atol=0.02)
    assert "nominal_zoom" in zoomed.scales and "nominal_zoom" not in plain.scales
