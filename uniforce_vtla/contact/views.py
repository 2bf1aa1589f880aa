"""Images of many contacts from one random unit, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uniforce_vtla.contact.options import ContactOptions
from uniforce_vtla.contact.simulator import TactileSimulator
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import VirtualSensor, as_virtual
from uniforce_vtla.contracts import ContactState

Transform = Callable[[np.ndarray], np.ndarray]  # (B, 480, 640) uint8 → (B, …), e.g. an area resize

_CHUNK = 16  # images drawn at once: 5 MB, stays in cache


def draw_simulator(
    rng: np.random.Generator,
    sensor: str | VirtualSensor,
    unit_strength: float,
    options: ContactOptions,
    look: Look | None = None,
) -> TactileSimulator:
    """Return a simulator of a random unit of ``sensor``, seen by a random camera where a ``look`` is given."""
    unit = UnitVariation.draw(rng, sensor, unit_strength)
    if look is not None and as_virtual(sensor).spec.signal == "camera":
        unit = unit.seen_through(rng, look)
    return TactileSimulator(sensor, unit, options, seed=int(rng.integers(2**31)))


def slices(n: int, size: int) -> list[slice]:
    """Return slices that cut ``n`` rows into pieces of ``size``, the last one shorter."""
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]


def rows_of(contact: ContactState, rows: slice) -> ContactState:
    """Return some rows of a batch of contacts."""
    return ContactState(contact.gap_mm[rows], contact.force_N[rows], contact.torsion_Nmm[rows])


def images_of(
    simulator: TactileSimulator, contact: ContactState, transform: Transform | None = None
) -> np.ndarray:
    """Return (B, …) images chunk by chunk, so that only a transform's (small) results pile up."""
    chunks = []
    for part in slices(len(contact.gap_mm), _CHUNK):
        images = simulator.marker_images(rows_of(contact, part))
        chunks.append(transform(images) if transform else images)
    return np.concatenate(chunks)
