"""The simulation still draws the frozen sets. A change of it takes their tables' ground away.

It runs with `make test`: a change of contact or of a sensor's response is seen before it is merged.
"""

from dataclasses import replace

import pytest

from benchmarks.probes.hard_sets import HETERO_HARD, draw_hard, hetero_sensors

BRIEF = replace(HETERO_HARD, sequences=2, length=4)

# by code that draws the whole set to its committed hash. The same code draws a uSkin otherwise on
# another processor: two are known
SCORED = {
    "gelsight_d": ("8e6c838602f5",),
    "tactip": ("f217d66e3144",),
    "uskin": ("179b340a7e17", "7652bdea6419"),
}


@pytest.mark.parametrize("name", SCORED)
def test_a_set_draws_as_it_was_scored(name):
    one = draw_hard(BRIEF, hetero_sensors()[name], 32)
    assert one.digest.startswith(SCORED[name])
    assert one.frames.shape == (2, 4, 32, 32) and one.force_N.shape == (2, 4, 3)
