"""Equilibrium pairs: one contact of two fingers, as each sensor sees it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from uniforce_vtla.contact import sampling
from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.responses import ContactOptions
from uniforce_vtla.contact.simulator import Transform, draw_simulator, images_of, rows_of, slices
from uniforce_vtla.contact.units import Look
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.markers.mirror import mirrored


@dataclass(frozen=True)
class PairBatch:
    """n equilibrium pairs; images in each sensor's own frame, never flipped."""

    # left_reference, left_current: (n, 480, 640) uint8, or what ``transform`` made of them
    left_reference: np.ndarray
    left_current: np.ndarray
    # right_reference, right_current: the same of the right finger, which sees the contact mirrored
    right_reference: np.ndarray
    right_current: np.ndarray
    force_N: np.ndarray  # (n, 3) in the canonical frame, i.e. the left finger's.
    torsion_Nmm: np.ndarray  # (n,) in the canonical frame
    indenters: tuple[str, ...]  # names of the objects


@dataclass(frozen=True)
class PairSettings:
    """How pairs are drawn."""

    # bounds of the loads
    force_range: sampling.ForceRange = field(default_factory=sampling.ForceRange)
    flat_share: float = 0.15  # of flat faces: the wiping eraser's side, which no indenter resembles
    flat_side_mm: tuple[float, float] = sampling.FLAT_SIDE_mm  # their shortest and longest side
    # how far they lean at most, along either axis of the pad
    flat_tilt_rad: float = sampling.FLAT_TILT_rad
    unit_strength: float = 1.0  # unit-to-unit variation; 0 for drawings only
    # of the same two units; building one takes as long as some twenty images
    pairs_per_unit: int = 64
    options: ContactOptions = field(default_factory=ContactOptions)  # friction and randomness
    look: Look | None = None  # how freely cameras differ; None leaves only the units' own tolerance
    # fingers not facing each other: the right contact moves, up to so many cells of 1.25 mm
    misaligned_cells: int = 0
    # broken equilibrium: the right force is off by up to this share of the normal force
    imbalance: float = 0.0

    def objects(
        self, rng: np.random.Generator, n: int, indenters: Sequence[str]
    ) -> sampling.Objects:
        """Return ``n`` random objects, flat faces as these settings say."""
        return sampling.sample_objects(
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
    settings: PairSettings | None = None,
    transform: Transform | None = None,
) -> PairBatch:
    """Return ``n`` pairs, of several units of each sensor.

    Args:
        rng: draws units, objects, loads and noise.
        n: number of pairs; each full-size image takes 300 kB.
        left_sensor: registry name of the left finger's sensor, or a virtual one.
        right_sensor: the right finger's.
        indenters: names to draw from.
        settings: loads, units and what may be wrong.
        transform: applied to (B, 480, 640) images before they are kept.
    """
    settings = settings or PairSettings()
    objects = settings.objects(rng, n, indenters)
    force, torsion = sampling.sample_loads(rng, n, settings.force_range, objects.names)
    contact = ContactState(objects.gap_mm, force, torsion)
    left = finger_views(rng, left_sensor, contact, settings, transform)
    right = finger_views(
        rng, right_sensor, mirrored(_disturbed(rng, contact, settings)), settings, transform
    )
    return PairBatch(*left, *right, force, torsion, objects.names)


def finger_views(
    rng: np.random.Generator,
    sensor: str | VirtualSensor,
    contact: ContactState,
    settings: PairSettings,
    transform: Transform | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, …) references and currents of one finger, a new unit every ``pairs_per_unit``.

    Args:
        rng: draws units and noise.
        sensor: registry name, or a virtual one.
        contact: n contacts as this finger gets them.
        settings: of the units; what decides contacts isn't read.
        transform: applied to (B, 480, 640) images before they are kept.
    """
    references = []
    currents = []
    for part in slices(len(contact.gap_mm), settings.pairs_per_unit):
        simulator = draw_simulator(
            rng, sensor, settings.unit_strength, settings.options, settings.look
        )
        currents.append(images_of(simulator, rows_of(contact, part), transform))
        reference = simulator.reference()[None]
        if transform:
            reference = transform(reference)
        references.append(np.repeat(reference, len(currents[-1]), axis=0))
    return np.concatenate(references), np.concatenate(currents)


def _disturbed(
    rng: np.random.Generator, contact: ContactState, settings: PairSettings
) -> ContactState:
    """Return the contact of the other finger, misaligned and out of balance as asked for."""
    gap = contact.gap_mm
    force = contact.force_N
    reach = settings.misaligned_cells
    if reach:
        starts = reach - rng.integers(-reach, reach + 1, (len(gap), 2))  # column, row
        # no object beyond
        padded = np.pad(gap, ((0, 0), (reach, reach), (reach, reach)), constant_values=np.inf)
        gap = np.empty_like(gap)
        cells = gap.shape[1]
        for row, (x, y) in enumerate(starts):
            gap[row] = padded[row, y : y + cells, x : x + cells]
    if settings.imbalance:
        off = rng.uniform(-1, 1, force.shape) * settings.imbalance * force[:, 2:]
        force = force + off
        shear = np.maximum(np.hypot(*force[:, :2].T), 1e-9)
        room = settings.force_range.friction * force[:, 2] / shear
        force[:, :2] *= np.minimum(1, room)[:, None]  # stays within friction
    return ContactState(gap, force.astype(np.float32), contact.torsion_Nmm)
