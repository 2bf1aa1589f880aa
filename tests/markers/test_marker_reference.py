"""Later frames are held against the reference: nothing is invented, nothing is lost unsaid."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from uniforce_vtla.contact.simulator import TactileSimulator, free_air
from uniforce_vtla.markers import Canonicalizer


@pytest.mark.parametrize("seed", range(3))
def test_crumbs_of_light_on_the_outer_pins_are_no_rim(seed: int) -> None:
    simulator, rng = TactileSimulator("tactip", seed=0), np.random.default_rng(seed)
    pins_px = simulator.markers_px(free_air(1))[0][0]
    middle = pins_px.mean(axis=0)
    radius = np.hypot(*(pins_px - middle).T).max()
    image = simulator.reference()
    for angle in np.linspace(0, 2 * np.pi, 20, endpoint=False):
        out = radius * rng.uniform(0.95, 1.04) * np.array([np.cos(angle), np.sin(angle)])
        at = np.rint(middle + out).astype(int).tolist()
        cv2.circle(image, at, int(rng.integers(2, 4)), 255, cv2.FILLED)  # 5 to 7 px across
    found = Canonicalizer("tactip").markers(np.repeat(image[..., None], 3, axis=2))
    assert (cKDTree(found).query(pins_px)[0] < 4).all()
