"""Images of stand-ins: free air first, then a press where it was asked for."""

import numpy as np
import pytest

from uniforce_robots.standins.scene import TAXEL_NOISE_COUNTS, Scene, taxel_cycle
from uniforce_vtla.contracts import QUARTERS
from uniforce_vtla.markers import Canonicalizer
from uniforce_vtla.markers.reference import capture_taxel_reference


def test_a_cycle_begins_in_free_air_and_presses_after():
    scene = Scene(rest_s=1, press_s=2)
    cycle = taxel_cycle(scene, 50)
    assert cycle.shape == (150, 16, 3) and cycle.dtype == np.uint16
    free = capture_taxel_reference(list(cycle[:50]))
    rise = (cycle[:, :, 2].astype(int) - free[:, 2]).max(axis=1)
    assert rise[:50].max() < 6 * TAXEL_NOISE_COUNTS and rise.argmax() == pytest.approx(100, abs=8)
    assert rise.max() > 100 * TAXEL_NOISE_COUNTS  # 8 N of a ball between four taxels


@pytest.mark.parametrize("where", QUARTERS)
def test_a_place_is_where_the_marker_image_shows_it(where):
    free = taxel_cycle(Scene(press_s=0), 2)[0]
    pressed = taxel_cycle(Scene(where=where, hold=True), 2)[0]
    pair = Canonicalizer("uskin").pair(free, pressed, "left")
    grown = pair.current.astype(int) - pair.reference
    rows = slice(240) if where.startswith("top") else slice(240, None)
    columns = slice(320) if where.endswith("left") else slice(320, None)
    assert grown[rows, columns].sum() > 0.4 * np.maximum(grown, 0).sum()
