"""Sensors of a simulated finger: words for units, and their images."""

import numpy as np
import pytest

from uniforce_vtla.contact import free_air
from uniforce_vtla.contact.worn import WornView
from uniforce_vtla.contact.worn_in_words import wear
from uniforce_vtla.errors import SensorError


def test_words_say_which_unit_is_worn():
    assert wear("tactip")(3) == wear("tactip:1")(8) != wear("tactip:2")(3)
    assert wear("uskin:any")(3) == wear("uskin:any")(3) != wear("uskin:any")(4)
    bare = wear("gelsight:drawing")(0)
    assert bare.direct and bare.light is None and bare.lag_steps == 0
    for wrong in ("gelsight:left", "gelsight:-1", "gelsight:1000000", "nose"):
        with pytest.raises(SensorError):
            wear(wrong)


@pytest.mark.parametrize("words", ["gelsight:3", "tactip:drawing", "uskin:3", "uskin_keen"])
def test_a_unit_in_free_air_shows_its_reference_but_for_noise(words):
    view = WornView(wear(words)(0), seed=4)
    (image,) = view.images(free_air(1))
    assert image.shape == (480, 640) and set(np.unique(image)) == {0, 255}
    assert np.mean(image != view.reference) < 0.06  # noise and lost markers
