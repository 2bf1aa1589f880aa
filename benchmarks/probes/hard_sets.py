"""Frozen labelled sets that are hard on purpose: what goes wrong on a bench goes wrong here too.

``hetero_hard_v2``: GelSight-D, whose pattern pretraining never saw, TacTip and uSkin. Every few
sequences wear another unit with another camera pose, light, marker size and missing markers. Camera
images go through raw frames and the real canonicalizer. Rubber creeps, so pictures lag behind their
labels. Six indenters are unseen. The recipe is that of v1, which was scored at 0.1.0; only the
contact model is another.
"""

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.probes.labelled_set import LabelledSet
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.contact.sampling import ForceRange, press_shear_release, sample_objects
from uniforce_vtla.contact.units import Look, UnitVariation
from uniforce_vtla.contact.virtual import GELSIGHT_D, VirtualSensor, as_virtual
from uniforce_vtla.contact.wear import Creep, Light, lagging_force
from uniforce_vtla.contact.worn import WornSensor, WornView
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.markers.registration import to_nominal_scale
from uniforce_vtla.tokenizer.descriptor import describe
from uniforce_vtla.tokenizer.pair_cache import shrink


@dataclass(frozen=True)
class HardSettings:
    """Faults and their doses; a frozen set's recipe."""

    name: str  # for people
    seed: int  # of everything drawn
    sequences: int  # per sensor
    length: int  # frames per sequence
    indenters: tuple[str, ...]  # names drawn from
    # 16 N, ±8 N: over-pressing is read too
    force_range: ForceRange = field(default_factory=ForceRange)
    sequences_per_unit: int = 4  # then another unit with another pose and light
    unit_strength: float = 1.5  # times the usual spread of stiffness, gain, moulding
    look: Look = field(default_factory=Look)  # camera pose and marker size
    marker_loss: float = 0.02  # chance per marker and frame; ViTac 2024 draws .01
    # part of the motion that comes late; rubbers .1–.3
    creep_share: tuple[float, float] = (0.05, 0.20)
    rate_hz: float = 10.0  # frames of a sequence: 12 take 1.2 s
    canonicalize: bool = True  # camera images are found in raw frames by the canonicalizer


HETERO_HARD = HardSettings(
    "hetero_hard_v2", seed=31_001, sequences=120, length=12, indenters=UNSEEN
)
HETERO_HARD_TRAINING = replace(
    HETERO_HARD, name="hetero_hard_training_v2", seed=31_002, sequences=400, indenters=SEEN
)


def hetero_sensors() -> dict[str, VirtualSensor]:
    return {s.name: s for s in (GELSIGHT_D, as_virtual("tactip"), as_virtual("uskin"))}


def draw_hard(settings: HardSettings, sensor: VirtualSensor, side: int) -> LabelledSet:
    """Return one sensor's sequences; contacts and forces are the same for every sensor of a recipe.

    The digest is that of the sensor's own images; what is read are those at nominal scale.

    Raises SensorError: the canonicalizer finds no markers; nothing is skipped.
    """
    contacts = np.random.default_rng(settings.seed)
    objects = sample_objects(contacts, settings.sequences, settings.indenters)
    loads = [
        press_shear_release(contacts, settings.length, settings.force_range)
        for _ in range(settings.sequences)
    ]
    # the name's digest, not its hash(): that one changes from process to process
    name = int.from_bytes(hashlib.sha256(sensor.name.encode()).digest()[:4])
    rng = np.random.default_rng([settings.seed, name])
    digest = hashlib.sha256(sensor.name.encode())
    rows = []
    for index, (gap, force) in enumerate(zip(objects.gap_mm, loads, strict=True)):
        if index % settings.sequences_per_unit == 0:
            view, creep = _draw_unit(settings, sensor, rng)
        lagging = lagging_force(force, creep, settings.rate_hz)
        contact = ContactState(
            np.repeat(gap[None], len(lagging), axis=0), lagging, np.zeros(len(lagging), np.float32)
        )
        before, after = view.reference, view.images(contact)
        digest.update(np.packbits(before > 0).tobytes() + np.packbits(after > 0).tobytes())
        before, after = (to_nominal_scale(images, sensor.spec) for images in (before, after))
        rows.append((shrink(before[None], side)[0], shrink(after, side), describe(before, after)))
    force_N = np.stack(loads)
    digest.update(np.ascontiguousarray(force_N).tobytes())
    reference, frames, descriptor = (np.stack(column) for column in zip(*rows, strict=True))
    return LabelledSet(reference, frames, descriptor, force_N, digest.hexdigest())


def _draw_unit(
    settings: HardSettings, sensor: VirtualSensor, rng: np.random.Generator
) -> tuple[WornView, Creep]:
    """Return a random unit with its camera and light, and its creep; taxels are drawn directly."""
    camera = sensor.spec.signal == "camera"
    unit = UnitVariation.draw(rng, sensor, settings.unit_strength)
    if camera:
        unit = unit.seen_through(rng, settings.look)
    seed, creep, light = (
        int(rng.integers(2**31)),
        Creep.draw(rng, settings.creep_share),
        Light.draw(rng),
    )
    loss = settings.marker_loss if camera else 0.0
    direct = not (settings.canonicalize and camera)
    worn = WornSensor(sensor, unit, light, marker_loss=loss, direct=direct)
    # the set's digest was locked with noise drawn anew and before patterns were registered
    return WornView(worn, seed, "drawn", register=False), creep
