"""The other finger's view of the same contact: left and right swap."""

from __future__ import annotations

import numpy as np

from uniforce_vtla.contracts import ContactState


def mirrored(contact: ContactState) -> ContactState:
    """Return what the right finger feels when the left feels ``contact`` (force in each finger's own frame).

    The gap flips left-right; fx and torsion change sign (a moment about the normal is a pseudo-scalar).
    """
    return ContactState(
        np.ascontiguousarray(contact.gap_mm[:, :, ::-1]),
        (contact.force_N * np.array([-1, 1, 1], dtype=np.float32)).astype(np.float32),
        -contact.torsion_Nmm,
    )
