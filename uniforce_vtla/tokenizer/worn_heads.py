"""Force heads for policies, fitted to simulated units of one kind of sensor as they are worn."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from tqdm import tqdm

from uniforce_vtla.contact.indenters import SEEN
from uniforce_vtla.contact.sampling import (
    FLAT,
    ForceRange,
    press_shear_release,
    sample_loads,
    sample_objects,
)
from uniforce_vtla.contact.simulator import slices
from uniforce_vtla.contact.virtual import any_virtual
from uniforce_vtla.contact.worn import WornView, unit_of
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.errors import SensorError
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead, HeadTrainingConfig, train_head
from uniforce_vtla.tokenizer.latent import POOL, pool_latent

BATCH = 15  # contacts drawn at once
# less noise and more steps than a table's heads: they see 80 units, not 8. Of .1, .4 and .8 what
# read other TacTips' press in the scene best, by scatter and scale, without a slope that only
# TacTips have
WORN_HEADS = HeadTrainingConfig(steps=1500, batch=128, input_noise=0.4)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class WornSequences:
    """Sequences to draw; units by number, none of which a benchmark wears."""

    first_unit: int = 500_000
    units: int = 80
    moving: int = 15  # sequences of a unit that press, shear and release, each another object
    held: int = 45  # that stand still, at any load: more objects for the same number of frames
    length: int = 6  # frames of a sequence
    indenters: tuple[str, ...] = SEEN
    flat_share: float = 0.5  # held tools: what a policy's fingers hold
    # an even pressure over a 25 mm pad carries 9.6 mm times friction times force
    force_range: ForceRange = field(default_factory=lambda: ForceRange(flat_torsion_arm_mm=9.0))


def fit_head(kind: str, tokenizer: Tokenizer, settings: WornSequences | None = None) -> ForceHead:
    """Return a head fitted to a tokenizer's latents of simulated sensors of one kind."""
    z, force_N = draw_worn(settings or WornSequences(), kind, tokenizer)
    return ForceHead(train_head(z, force_N, WORN_HEADS, seed=0), kind, tokenizer.hash)


def draw_worn(
    settings: WornSequences, kind: str, tokenizer: Tokenizer
) -> tuple[torch.Tensor, np.ndarray]:
    """Return pooled latents (n, T, P, L) of a kind's units, worn left, and force (n, T, 3) N.

    Contacts whose frames the canonicalizer refuses are left out, and logged.
    """
    found: list[tuple[torch.Tensor, np.ndarray]] = []
    for number in tqdm(
        range(settings.first_unit, settings.first_unit + settings.units), desc=f"units of {kind}"
    ):
        rng = np.random.default_rng([number, 77])
        view = WornView(unit_of(any_virtual(kind), number), number)
        for contact in _moving(rng, settings):
            found += [(z[None], contact.force_N[None]) for z in _seen(view, contact, tokenizer)]
        for contact in _held(rng, settings):
            force = np.repeat(contact.force_N[:, None], settings.length, axis=1)
            found += [
                (z[:, None].expand(-1, settings.length, -1, -1), force)
                for z in _seen(view, contact, tokenizer)
            ]
    latents, forces = zip(*found, strict=True)
    return torch.cat(latents), np.concatenate(forces)


def _seen(view: WornView, contact: ContactState, tokenizer: Tokenizer) -> list[torch.Tensor]:
    """Return the (B, P, L) pooled latents of contacts in a list.

    An empty one where a frame is refused.
    """
    try:
        images = view.images(contact)
    except SensorError as error:
        logger.info("unit of %s: %s", view.worn.kind, error)
        return []
    return [
        pool_latent(tokenizer.encode(view.reference[None], images), POOL).as_subclass(torch.Tensor)
    ]


def _moving(rng: np.random.Generator, settings: WornSequences) -> Iterator[ContactState]:
    """Yield a contact of ``length`` moments per sequence."""
    objects = sample_objects(rng, settings.moving, settings.indenters, settings.flat_share)
    for gap, name in zip(objects.gap_mm, objects.names, strict=True):
        force = press_shear_release(rng, settings.length, settings.force_range)
        twist = _twist(rng, force, settings.force_range, name == FLAT)
        yield ContactState(np.repeat(gap[None], settings.length, axis=0), force, twist)


def _held(rng: np.random.Generator, settings: WornSequences) -> Iterator[ContactState]:
    """Yield contacts that have nothing to do with each other, ``BATCH`` at a time."""
    objects = sample_objects(rng, settings.held, settings.indenters, settings.flat_share)
    force, torsion = sample_loads(rng, settings.held, settings.force_range, objects.names)
    for part in slices(settings.held, BATCH):
        yield ContactState(objects.gap_mm[part], force[part], torsion[part])


def _twist(
    rng: np.random.Generator, force: np.ndarray, bounds: ForceRange, flat: bool
) -> np.ndarray:
    """Return (T,) Nmm of torsion that friction has left beside the shear.

    None in half of the sequences.
    """
    room = bounds.friction * force[:, 2]
    spare = np.sqrt(np.maximum(1 - (np.hypot(*force[:, :2].T) / np.maximum(room, 1e-9)) ** 2, 0))
    arm_mm = bounds.flat_torsion_arm_mm if flat else bounds.torsion_arm_mm
    share = rng.uniform(-1, 1) if rng.random() < 0.5 else 0.0
    return (share * spare * room * arm_mm).astype(np.float32)
