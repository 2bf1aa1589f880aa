"""Label-free calibration on finite elements: grasps of each unit of a set with an anchor, then its frozen contacts.

The unit's pictures come from contacts solved step by step, the anchor's from the fast model under the same force. The
anchor is a unit as drawn: its newtons are known, or no calibration could give any.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from benchmarks.finite_elements.contacts import solve_contacts
from benchmarks.finite_elements.sets import STEPS, Unit, pictures
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import encode_set, score
from uniforce_vtla.contact.sampling import FLAT
from uniforce_vtla.contact.simulator import TactileSimulator, images_of
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.markers.mirror import mirrored
from uniforce_vtla.markers.registration import to_nominal_scale
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.calibrate import calibrate
from uniforce_vtla.tokenizer.calibration import Calibration
from uniforce_vtla.tokenizer.latent import POOL, Latent, pool_latent
from uniforce_vtla.tokenizer.pair_cache import shrink

GRASPS_SEED = 41_003  # of grasps: none of them is in a frozen set
TOOLS = 0.5  # share of held tools


@dataclass(frozen=True)
class UnitGrasps:
    """Images of one unit while it grasps."""

    reference: np.ndarray  # (480, 640) uint8
    images: np.ndarray  # (n, 480, 640) uint8
    contact: ContactState  # of each picture, as this finger gets it
    classes: tuple[str, ...]  # (n,) "small" or "tool"


def grasp(unit: Unit, number: int, pairs: int) -> UnitGrasps:
    """Return ``pairs`` grasps of a unit; some minutes."""
    rng = np.random.default_rng([GRASPS_SEED, number])
    contacts = solve_contacts(rng, unit.body, pairs // len(STEPS), TOOLS)
    simulator = unit.simulator()
    images = [pictures(simulator, contact, STEPS)[0] for contact in contacts]
    state = ContactState(
        np.repeat(np.stack([c.gap_mm for c in contacts]), len(STEPS), axis=0),
        np.concatenate([c.force_N[list(STEPS)] for c in contacts]).astype(np.float32),
        np.concatenate([c.torsion_Nmm[list(STEPS)] for c in contacts]).astype(np.float32),
    )
    classes = tuple("tool" if c.name == FLAT else "small" for c in contacts for _ in STEPS)
    return UnitGrasps(simulator.reference(), np.concatenate(images), state, classes)


def encode(
    tokenizer: Tokenizer,
    sensor: VirtualSensor,
    reference: np.ndarray,
    images: np.ndarray,
    right: bool = False,
) -> Latent:
    """Return pooled latents (n, P, L) of full-size images."""
    side = tokenizer.config.side
    before = shrink(to_nominal_scale(reference[None], sensor.spec), side)
    after = shrink(to_nominal_scale(images, sensor.spec), side)
    z = tokenizer.encode(before, after, "right" if right else "left")
    return pool_latent(z, POOL)  # type: ignore[return-value]


def calibrate_unit(
    tokenizer: Tokenizer,
    head: ForceHead,
    sensors: tuple[VirtualSensor, VirtualSensor],
    grasps: UnitGrasps,
    number: int,
) -> Calibration:
    """Return the calibration of unit ``number`` of the first of ``sensors`` against the second, its anchor."""
    sensor, anchor = sensors
    other = TactileSimulator(anchor, seed=GRASPS_SEED + number)
    seen = images_of(other, mirrored(grasps.contact))
    new = encode(tokenizer, sensor, grasps.reference, grasps.images)
    known = encode(tokenizer, anchor, other.reference(), seen, right=True)
    numbers = np.arange(len(new)) // len(STEPS)  # the steps of one contact are one grasp
    return calibrate(
        new, known, grasps.classes, head, sensor.name, anchor.name, grasps=numbers.tolist()
    )


def calibrated_cell(
    tokenizer: Tokenizer,
    head: ForceHead,
    sensors: tuple[VirtualSensor, VirtualSensor],
    grasps: list[UnitGrasps],
    frozen: LabelledSet,
) -> dict[str, Any]:
    """Return scores of the anchor's head on a sensor's frozen contacts, each unit calibrated by its own grasps."""
    z = encode_set(tokenizer, frozen).as_subclass(torch.Tensor)  # (n, T, P, L), unit by unit
    each = len(z) // len(grasps)
    said = []
    for number, own in enumerate(grasps):
        found = calibrate_unit(tokenizer, head, sensors, own, number)
        latent = Latent.of(z[number * each : (number + 1) * each].flatten(0, 1), tokenizer.hash)
        said.append(head(found(latent)).numpy())
    read_N, true_N = np.concatenate(said), frozen.force_N.reshape(-1, 3)
    slope = [float(np.polyfit(true_N[:, k], read_N[:, k], 1)[0]) for k in range(3)]
    return score(true_N, read_N) | {"slope": slope}
