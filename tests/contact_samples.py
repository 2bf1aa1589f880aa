"""Contacts that tests of several rooms press on simulated pads, and a finger without a device."""

import numpy as np

from uniforce_vtla.contact import flat_face_gap, gap_map
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.markers import Canonicalizer


class StillFinger:
    """A finger that has its reference, as far as checks need one; a subclass has its next
    frames."""

    def __init__(self, sensor, reference):
        canonicalizer = Canonicalizer(sensor, stream=True)
        canonicalizer.set_reference(reference)
        self.reference_raw, self.marker_image = reference, canonicalizer.marker_image

    def reference_image(self):
        return self.marker_image(self.reference_raw)[..., None]


def faces(force_N, side_mm):
    """Return contacts of square flat faces at the middle of a pad under forces (n, 3), N."""
    n = len(force_N)
    middle = np.zeros((n, 2))
    gap_mm = flat_face_gap(middle, np.full((n, 2), side_mm), np.zeros(n), middle)
    return ContactState(gap_mm, np.asarray(force_N, np.float32), np.zeros(n, np.float32))


def sphere(*force_N):
    """Return the contact of a sphere at the middle of a pad under a force x, y, z in N."""
    gap_mm = gap_map("sphere", center_mm=(0.0, 0.0), angle_rad=0.0)[None]
    return ContactState(gap_mm, np.array([force_N], np.float32), np.zeros(1, np.float32))
