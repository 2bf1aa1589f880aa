"""Equilibrium pairs: one contact felt by two fingers, as each sensor sees it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.mirror import mirrored
from uniforce_vtla.contact.options import ContactOptions
from uniforce_vtla.contact.sampling import (
    FLAT_SIDE_mm,
    FLAT_TILT_rad,
    ForceRange,
    Objects,
    sample_loads,
    sample_objects,
)
from uniforce_vtla.contact.units import Look
from uniforce_vtla.contact.views import Transform, draw_simulator, images_of, rows_of, slices
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.contracts import ContactState


@dataclass(frozen=True)
class PairBatch:
    """n equilibrium pairs; images in each sensor's own frame, never flipped.

    Attributes:
        left_reference, left_current: (n, 480, 640) uint8, or what ``transform`` made of them.
        right_reference, right_current: likewise, the right finger's view (mirrored contact).
        force_N: (n, 3) in the canonical frame, i.e. the left finger's.
        torsion_Nmm: (n,) likewise.
        indenters: names of the objects.
    """

    left_reference: np.ndarray
    left_current: np.ndarray
    right_reference: np.ndarray
    right_current: np.ndarray
    force_N: np.ndarray
    torsion_Nmm: np.ndarray
    indenters: tuple[str, ...]


@dataclass(frozen=True)
class PairSettings:
    """How pairs are drawn.

    Attributes:
        force_range: bounds of the loads.
        flat_share: share of flat faces (the side of a held tool) beside the named indenters.
        flat_side_mm: their shortest and longest side.
        flat_tilt_rad: how far they lean at most, along either axis of the pad.
        unit_strength: unit-to-unit variation; 0 for drawings only.
        pairs_per_unit: pairs felt by the same two units before others take over.
        options: terms of the contact model.
        look: how freely cameras differ from unit to unit; None leaves only the units' own tolerance.
        misaligned_cells: fingers that don't face each other: the right contact moves by up to so many mm.
        imbalance: broken equilibrium: the right finger's force is off by up to this share of the normal force.
    """

    force_range: ForceRange = field(default_factory=ForceRange)
    flat_share: float = 0.15  # the wiping eraser presses a flat side, which no indenter resembles
    flat_side_mm: tuple[float, float] = FLAT_SIDE_mm
    flat_tilt_rad: float = FLAT_TILT_rad
    unit_strength: float = 1.0
    pairs_per_unit: int = 64  # building a unit takes as long as some twenty images
    options: ContactOptions = field(default_factory=ContactOptions)
    look: Look | None = None
    misaligned_cells: int = 0
    imbalance: float = 0.0

    def objects(self, rng: np.random.Generator, n: int, indenters: Sequence[str]) -> Objects:
        """Return ``n`` random objects, flat faces as these settings say."""
        return sample_objects(
            rng,
            n,
            indenters,
            self.flat_share,
            flat_side_mm=self.flat_side_mm,
            flat_tilt_rad=self.flat_tilt_rad,
        )


def equilibrium_pairs(
    rng: np.random.Generator,
    n: int,
    left_sensor: str | VirtualSensor,
    right_sensor: str | VirtualSensor,
    indenters: Sequence[str] = PRETRAIN,
    force_range: ForceRange | None = None,
    settings: PairSettings | None = None,
    transform: Transform | None = None,
) -> PairBatch:
    """Return ``n`` pairs, felt by several units of each sensor.

    Args:
        rng: draws units, objects, loads and noise.
        n: number of pairs; each full-size image takes 300 kB.
        left_sensor: registry name of the left finger's sensor, or a virtual one.
        right_sensor: the right finger's.
        indenters: names to draw from.
        force_range: bounds of the loads; overrides ``settings``.
        settings: everything else.
        transform: applied to (B, 480, 640) images before they are kept.
    """
    settings = settings or PairSettings()
    objects = settings.objects(rng, n, indenters)
    force, torsion = sample_loads(rng, n, force_range or settings.force_range, objects.names)
    contact = ContactState(objects.gap_mm, force, torsion)
    left = finger_views(rng, left_sensor, contact, settings, transform)
    right = finger_views(rng, right_sensor, mirrored(_disturbed(rng, contact, settings)), settings, transform)
    return PairBatch(*left, *right, force, torsion, objects.names)


def pair_batches(
    rng: np.random.Generator,
    batch: int,
    left_sensor: str | VirtualSensor,
    right_sensor: str | VirtualSensor,
    indenters: Sequence[str] = PRETRAIN,
    settings: PairSettings | None = None,
    transform: Transform | None = None,
) -> Iterator[PairBatch]:
    """Yield batches of ``batch`` pairs without end, each from fresh units; memory stays one batch."""
    while True:
        yield equilibrium_pairs(
            rng, batch, left_sensor, right_sensor, indenters, settings=settings, transform=transform
        )


def finger_views(
    rng: np.random.Generator,
    sensor: str | VirtualSensor,
    contact: ContactState,
    settings: PairSettings,
    transform: Transform | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, …) references and currents of one finger, a fresh unit every ``pairs_per_unit`` contacts.

    Args:
        rng: draws units and noise.
        sensor: registry name, or a virtual one.
        contact: n contacts as this finger gets them.
        settings: of the units; what decides contacts isn't read.
        transform: applied to (B, 480, 640) images before they are kept.
    """
    references, currents = [], []
    for part in slices(len(contact.gap_mm), settings.pairs_per_unit):
        simulator = draw_simulator(rng, sensor, settings.unit_strength, settings.options, settings.look)
        currents.append(images_of(simulator, rows_of(contact, part), transform))
        reference = simulator.reference()[None]
        kept = transform(reference) if transform else reference
        references.append(np.repeat(kept, len(currents[-1]), axis=0))
    return np.concatenate(references), np.concatenate(currents)


def _disturbed(rng: np.random.Generator, contact: ContactState, settings: PairSettings) -> ContactState:
    """Return the contact as the other finger gets it: the same, but for misalignment and imbalance asked for."""
    gap, force = contact.gap_mm, contact.force_N
    if settings.misaligned_cells:
        shifts = rng.integers(-settings.misaligned_cells, settings.misaligned_cells + 1, (len(gap), 2))
        gap = np.stack([_moved(g, int(x), int(y)) for g, (x, y) in zip(gap, shifts, strict=True)])
    if settings.imbalance:
        off = rng.uniform(-1, 1, force.shape) * settings.imbalance * force[:, 2:]
        force = force + off
        room = settings.force_range.friction * force[:, 2] / np.maximum(np.hypot(*force[:, :2].T), 1e-9)
        force[:, :2] *= np.minimum(1, room)[:, None]  # stays within friction
    return ContactState(gap, force.astype(np.float32), contact.torsion_Nmm)


def _moved(gap: np.ndarray, x: int, y: int) -> np.ndarray:
    """Return a (G, G) gap moved by whole cells; what comes in at the edge holds no object."""
    padded = np.pad(gap, max(abs(x), abs(y)), constant_values=np.inf)
    reach = max(abs(x), abs(y))
    rows, columns = gap.shape
    return padded[reach - y : reach - y + rows, reach - x : reach - x + columns]
