"""The procedural family of pretraining, and what lies outside it."""

import numpy as np
import pytest
from outside_family import half_extent_px, outside

from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.virtual import GELSIGHT_D, as_virtual
from uniforce_vtla.tokenizer.family import FamilyBounds, FlatFamily, draw_dome, draw_flat


@pytest.mark.parametrize("draw", [draw_flat, draw_dome])
def test_every_member_of_the_family_is_inside_it_and_in_view(draw):
    rng = np.random.default_rng(4)
    for _ in range(40):
        sensor = draw(rng)
        assert outside(sensor) == []
        assert len(sensor.spec.layout_mm) >= 12 and np.all(half_extent_px(sensor) < (320, 240))


def test_the_family_draws_different_pictures():
    rng = np.random.default_rng(1)
    pictures = [TactileSimulator(draw_flat(rng)).reference() for _ in range(4)]
    assert len({p.tobytes() for p in pictures}) == 4


def test_outside_names_what_differs():
    assert outside(GELSIGHT_D) == ["visible: marker_shape diamond"]
    narrow = FamilyBounds(flat=FlatFamily(px_per_mm=(10.0, 12.0)))
    assert any("px_per_mm" in line for line in outside(as_virtual("gelsight"), narrow))
