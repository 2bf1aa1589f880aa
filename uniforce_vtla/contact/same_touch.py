"""The same touches as several sensors feel them: what a grasp of two fingers shows of two, of as many as wanted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.pairs import PairSettings, finger_views
from uniforce_vtla.contact.sampling import sample_loads, sample_objects
from uniforce_vtla.contact.views import Transform
from uniforce_vtla.contracts import ContactState


def same_touches(
    rng: np.random.Generator,
    blocks: int,
    sensors: Sequence[str],
    settings: PairSettings,
    transform: Transform | None = None,
) -> Iterator[list[tuple[np.ndarray, np.ndarray]]]:
    """Yield ``blocks`` times what ``settings.pairs_per_unit`` touches look like to a fresh unit of each sensor.

    All as the left finger sees them: one contact, nothing mirrored.

    Yields:
        per sensor the reference (480, 640) and the currents (n, 480, 640), or what ``transform`` made of them.
    """
    n = settings.pairs_per_unit
    for _ in range(blocks):
        objects = sample_objects(rng, n, PRETRAIN, settings.flat_share)
        contact = ContactState(objects.gap_mm, *sample_loads(rng, n, settings.force_range, objects.names))
        seen = [finger_views(rng, sensor, contact, settings, transform) for sensor in sensors]
        yield [(references[0], currents) for references, currents in seen]
