"""Force-labelled sequences of one sensor: press, shear, release (the collection protocol of GenForce)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from uniforce_vtla.contact.indenters import SEEN
from uniforce_vtla.contact.responses import ContactOptions
from uniforce_vtla.contact.sampling import PAPER_RANGE, ForceRange, sample_objects
from uniforce_vtla.contact.simulator import Transform, draw_simulator, images_of
from uniforce_vtla.contracts import ContactState


@dataclass(frozen=True)
class SequenceBatch:
    """n sequences of a sensor worn on the left finger (its image frame is the canonical one)."""

    reference: np.ndarray  # (n, 480, 640) uint8, or what ``transform`` made of it
    frames: np.ndarray  # (n, length, 480, 640) uint8, likewise
    force_N: np.ndarray  # (n, length, 3) fx, fy, fz
    indenters: tuple[str, ...]  # (n,) names
    sensor: str  # registry name


def force_sequences(
    rng: np.random.Generator,
    sensor: str,
    n: int,
    length: int,
    indenters: Sequence[str] = SEEN,
    force_range: ForceRange = PAPER_RANGE,
    unit_strength: float = 1.0,
    flat_share: float = 0.0,
    units: int = 8,
    options: ContactOptions | None = None,
    transform: Transform | None = None,
) -> SequenceBatch:
    """Return ``n`` sequences of ``length`` frames of a registered sensor.

    ``units`` of it take turns, which differ as much as ``unit_strength`` says, 0 for the drawing; ``flat_share`` of the
    objects are flat faces. ``transform`` is applied to (B, 480, 640) images before they are kept.
    """
    objects = sample_objects(rng, n, indenters, flat_share)
    force = np.stack([press_shear_release(rng, length, force_range) for _ in range(n)])
    pool = [draw_simulator(rng, sensor, unit_strength, options or ContactOptions()) for _ in range(min(units, n))]
    references, frames = [], []
    for index, (gap, load) in enumerate(zip(objects.gap_mm, force, strict=True)):
        simulator = pool[index % len(pool)]
        contact = ContactState(np.repeat(gap[None], length, axis=0), load, np.zeros(length, np.float32))
        reference = simulator.reference()[None]
        references.append((transform(reference) if transform else reference)[0])
        frames.append(images_of(simulator, contact, transform))
    return SequenceBatch(np.stack(references), np.stack(frames), force, objects.names, sensor)


def press_shear_release(rng: np.random.Generator, length: int, force_range: ForceRange) -> np.ndarray:
    """Return (length, 3) float32 force: press in, shear out and back, release, with a little wobble.

    The four parts take random shares of the time; the peak normal force is even over the range, and so is
    the peak shear within friction.
    """
    corners = np.concatenate([[0], np.cumsum(rng.dirichlet(np.full(4, 4.0)))])  # 0 … 1
    time = np.linspace(0, 1, length)
    press = np.interp(time, corners, [0, 1, 1, 1, 0]) * rng.uniform(0.05, 1) * force_range.normal_N
    direction = rng.uniform(-np.pi, np.pi)
    unit = np.array([np.cos(direction), np.sin(direction)])
    peak = min(force_range.shear_N / np.abs(unit).max(), force_range.friction * press.max()) * rng.random()
    shear = np.interp(time, corners, [0, 0, 1, 0, 0])[:, None] * peak * unit
    wobble = 1 + 0.03 * rng.standard_normal(length)  # hand and robot never hold a force exactly
    fz = press * wobble
    room = np.minimum(1, force_range.friction * fz / np.maximum(np.hypot(*shear.T), 1e-9))
    return np.concatenate([shear * room[:, None], fz[:, None]], axis=1).astype(np.float32)
