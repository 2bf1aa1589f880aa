"""What two fingers of one grasp feel, for as many sensors as wanted: the same grip and pull, the rest of their own.

Statics shares the force of a grasp equally between its fingers; how torsion about the closing axis is shared hangs on
both pads, and a couple about the other axes pushes the fingers apart sideways: an eraser grasped a little turned stays
wedged between pads that stick. In the wiping scene the fingers' forces along the pad's height differ by .5 N from
episode to episode, sideways by up to 4 N, and their torsions by 50 Nmm, as much as each of them is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.pairs import PairSettings, finger_views
from uniforce_vtla.contact.sampling import ForceRange, sample_loads
from uniforce_vtla.contact.views import Transform
from uniforce_vtla.contracts import ContactState

Views = list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class OtherFinger:
    """How the second finger's load differs from the first's."""

    own_side: bool = True  # sideways (x) force drawn anew within friction; False: as the first finger's
    own_torsion: bool = True  # likewise


def two_fingers(
    rng: np.random.Generator,
    blocks: int,
    sensors: Sequence[str],
    settings: PairSettings,
    other: OtherFinger,
    transform: Transform | None = None,
) -> Iterator[tuple[Views, Views]]:
    """Yield ``blocks`` times what ``settings.pairs_per_unit`` grasps look like to fresh units of each sensor.

    All as the left finger sees them, the second finger's contacts too: nothing is mirrored.

    Yields:
        first and second finger; of each, per sensor, the reference (480, 640) and the currents (n, 480, 640), or what
        ``transform`` made of them.
    """
    n = settings.pairs_per_unit
    for _ in range(blocks):
        objects = settings.objects(rng, n, PRETRAIN)
        force, torsion = sample_loads(rng, n, settings.force_range, objects.names)
        loads = (force, torsion), _shared(rng, force, torsion, settings.force_range, other)
        first, second = (ContactState(objects.gap_mm, *load) for load in loads)
        yield (
            _seen(rng, sensors, first, settings, transform),
            _seen(rng, sensors, second, settings, transform),
        )


def _shared(
    rng: np.random.Generator, force: np.ndarray, torsion: np.ndarray, bounds: ForceRange, other: OtherFinger
) -> tuple[np.ndarray, np.ndarray]:
    """Return the second finger's force (n, 3) and torsion (n,)."""
    force, room = force.copy(), bounds.friction * force[:, 2]
    if other.own_side:
        widest = np.sqrt(np.maximum(room**2 - force[:, 1] ** 2, 0))
        force[:, 0] = rng.uniform(-1, 1, len(widest)) * widest
    if other.own_torsion:
        own = rng.uniform(-1, 1, len(torsion)) * room * bounds.flat_torsion_arm_mm
        torsion = own.astype(torsion.dtype)
    return force, torsion


def _seen(
    rng: np.random.Generator,
    sensors: Sequence[str],
    contact: ContactState,
    settings: PairSettings,
    transform: Transform | None,
) -> Views:
    views = [finger_views(rng, sensor, contact, settings, transform) for sensor in sensors]
    return [(references[0], currents) for references, currents in views]
