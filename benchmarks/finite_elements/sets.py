"""Labelled finite-element contacts, frozen before training.

``fe_dev_v1`` is for choosing, ``fe_contacts_v1`` for scoring. Each sensor comes in three bodies of
other thickness, Poisson's ratio, stiffness and marker depth, and two units of each. Every step of
a contact's path is a labelled frame.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from benchmarks.finite_elements.contacts import CELL_MM, Contact, solve_contacts
from benchmarks.probes.labelled_set import LabelledSet
from uniforce_vtla.contact import ContactOptions, TactileSimulator, UnitVariation
from uniforce_vtla.contact.traction import Traction
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.markers.registration import to_nominal_scale
from uniforce_vtla.sensors.material import Layer, Material
from uniforce_vtla.tokenizer.descriptor import describe
from uniforce_vtla.tokenizer.pair_cache import shrink

STEPS = (1, 4, 5, 6, 7)  # of a contact's path: two while it presses, three while it slides
UNITS_PER_BODY = 2


@dataclass(frozen=True)
class ElementSettings:
    """A frozen set's recipe."""

    name: str  # for people
    seed: int  # of everything drawn
    contacts: int  # per sensor, each of ``STEPS`` labelled frames
    flat_share: float = 0.4  # of held flat tools; the others are all 18 indenters
    friction: float = 1.0
    steps: tuple[int, ...] = STEPS


FE_DEV = ElementSettings("fe_dev_v1", seed=41_001, contacts=36)
FE_CONTACTS = ElementSettings("fe_contacts_v1", seed=41_002, contacts=78)

# (thickness, Young's modulus, Poisson's ratio, readout) over the nominal ones; a dome's of skin and
# filling
_SPREAD = ((0.8, 0.9, 1.02, 1.3), (1.0, 1.0, 1.0, 1.0), (1.2, 1.1, 0.98, 0.75))


def bodies(sensor: VirtualSensor) -> list[VirtualSensor]:
    return [replace(sensor, material=_changed(sensor.material, *factors)) for factors in _SPREAD]


def _changed(
    material: Material, thick: float, young: float, poisson: float, readout: float
) -> Material:
    layers = []
    for layer in material.layers:
        ratio = min(layer.poisson * poisson, 0.49)
        layers.append(Layer(layer.thickness_mm * thick, layer.young_MPa * young, ratio))
    depth_mm = material.readout_mm * readout
    if len(layers) > 1:  # pins root in the skin
        depth_mm = layers[0].thickness_mm
    return replace(material, layers=tuple(layers), readout_mm=depth_mm)


@dataclass(frozen=True)
class Unit:
    """One unit of a set: what it is made of, how it is built, seen through the finer mesh."""

    body: VirtualSensor
    variation: UnitVariation
    seed: int  # of its noise

    def simulator(self) -> TactileSimulator:
        """Return it; the contacts were solved with the body's own stiffness, so the unit's is 1."""
        fine = replace(
            self.body, material=replace(self.body.material, cell_mm=CELL_MM[self.body.like])
        )
        return TactileSimulator(
            fine, replace(self.variation, stiffness=1.0), ContactOptions(), seed=self.seed
        )


def units(settings: ElementSettings, sensor: VirtualSensor) -> list[Unit]:
    """Return the units of one sensor in a set: ``UNITS_PER_BODY`` of each body."""
    found = []
    for number, body in enumerate(bodies(sensor)):
        for which in range(UNITS_PER_BODY):
            rng = np.random.default_rng([settings.seed, _name_seed(sensor), number, which])
            found.append(Unit(body, UnitVariation.draw(rng, body), int(rng.integers(2**31))))
    return found


def draw_elements(settings: ElementSettings, sensor: VirtualSensor, side: int) -> LabelledSet:
    """Return one sensor's contacts, unit by unit; the digest is of its own images and forces."""
    digest = hashlib.sha256(sensor.name.encode())
    rng = np.random.default_rng([settings.seed, _name_seed(sensor)])
    each = settings.contacts // len(_SPREAD) // UNITS_PER_BODY
    reference = []
    frames = []
    descriptor = []
    forces = []
    for unit in tqdm(units(settings, sensor), desc=f"solving {sensor.name}", leave=False):
        contacts = solve_contacts(rng, unit.body, each, settings.flat_share, settings.friction)
        simulator = unit.simulator()
        before = simulator.reference()
        for contact in contacts:
            after, force = pictures(simulator, contact, settings.steps)
            for part in (np.packbits(before > 0), np.packbits(after > 0), force):
                digest.update(part.tobytes())
            free = to_nominal_scale(before[None], sensor.spec)
            pressed = to_nominal_scale(after, sensor.spec)
            reference.append(shrink(free, side)[0])
            frames.append(shrink(pressed, side))
            descriptor.append(describe(free[0], pressed))
            forces.append(force)
    return LabelledSet(
        np.stack(reference),
        np.stack(frames),
        np.stack(descriptor),
        np.stack(forces),
        digest.hexdigest(),
    )


def pictures(
    simulator: TactileSimulator, contact: Contact, steps: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return marker images (T, 480, 640) and forces (T, 3) of some steps of a contact."""
    cells = [contact.cells[k] for k in steps]
    press = np.stack([c.press_N for c in cells]).astype(np.float32)
    shear = np.stack([c.shear_N for c in cells]).astype(np.float32)
    images = simulator.images_under(Traction(np.arange(press.shape[1]), press, shear))
    return images, contact.force_N[list(steps)]


def _name_seed(sensor: VirtualSensor) -> int:
    return int.from_bytes(hashlib.sha256(sensor.name.encode()).digest()[:4])
