"""Force-labelled sequences for heads and the zero-shot set; all sensors get the same contacts."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_vtla.array_file import read_arrays
from uniforce_vtla.contact import PAPER_RANGE, SEEN, UNSEEN, ContactOptions, ForceRange
from uniforce_vtla.contact.sampling import press_shear_release, sample_objects
from uniforce_vtla.contact.simulator import Transform, draw_simulator, images_of
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.tokenizer.descriptor import describe
from uniforce_vtla.tokenizer.pair_cache import shrink


@dataclass(frozen=True)
class SequenceBatch:
    """n sequences of a sensor worn on the left finger (its image frame is the canonical one)."""

    reference: np.ndarray  # (n, 480, 640) uint8, or what ``transform`` made of it
    frames: np.ndarray  # (n, length, 480, 640) uint8, or what ``transform`` made of them
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

    ``units`` of it take turns, which differ as much as ``unit_strength`` says, 0 for the drawing;
    ``flat_share`` of the objects are flat faces. ``transform`` is applied to (B, 480, 640) images
    before they are kept.
    """
    objects = sample_objects(rng, n, indenters, flat_share)
    force = np.stack([press_shear_release(rng, length, force_range) for _ in range(n)])
    pool = [
        draw_simulator(rng, sensor, unit_strength, options or ContactOptions())
        for _ in range(min(units, n))
    ]
    references, frames = [], []
    for index, (gap, load) in enumerate(zip(objects.gap_mm, force, strict=True)):
        simulator = pool[index % len(pool)]
        contact = ContactState(
            np.repeat(gap[None], length, axis=0), load, np.zeros(length, np.float32)
        )
        reference = simulator.reference()[None]
        references.append((transform(reference) if transform else reference)[0])
        frames.append(images_of(simulator, contact, transform))
    return SequenceBatch(np.stack(references), np.stack(frames), force, objects.names, sensor)


SENSORS = ("gelsight", "tactip", "uskin")


@dataclass(frozen=True)
class SetConfig:
    """Recipe of a labelled set."""

    name: str  # for people
    seed: int  # of contacts, units and noise
    sequences: int  # per sensor, each from its own unit and indenter placement
    length: int  # frames per sequence
    indenters: tuple[str, ...]  # names drawn from
    # 16 N, ±8 N: over-pressing is read too
    force_range: ForceRange = field(default_factory=ForceRange)
    flat_share: float = 0.0  # of held flat tools among the indenters


FROZEN = SetConfig("zero_shot_v2", seed=7_001, sequences=120, length=12, indenters=UNSEEN)
# half of them held tools: that is what a policy's fingers hold
HEAD_TRAINING = SetConfig(
    "head_training_v2", seed=7_002, sequences=400, length=12, indenters=SEEN, flat_share=0.5
)


@dataclass(frozen=True)
class LabelledSet:
    """One sensor's sequences, n × T frames."""

    reference: np.ndarray  # (n, S, S) uint8, area-resized
    frames: np.ndarray  # (n, T, S, S) uint8
    descriptor: np.ndarray  # (n, T, 6) float32, the hand descriptor of every frame
    force_N: np.ndarray  # (n, T, 3) canonical
    digest: str  # sha256 over full-size images and forces


def draw_labelled(config: SetConfig, sensor: str, side: int) -> LabelledSet:
    """Return a sensor's sequences, at the model's size, with descriptors of full-size images."""
    rng = np.random.default_rng(config.seed)
    drawn = config.indenters, config.force_range, 1.0, config.flat_share
    batch = force_sequences(rng, sensor, config.sequences, config.length, *drawn)
    digest = hashlib.sha256(sensor.encode())
    reference, frames, descriptor = [], [], []
    for before, after in zip(batch.reference, batch.frames, strict=True):
        digest.update(np.packbits(before > 0).tobytes() + np.packbits(after > 0).tobytes())
        reference.append(shrink(before[None], side)[0])
        frames.append(shrink(after, side))
        descriptor.append(describe(before, after))
    digest.update(np.ascontiguousarray(batch.force_N).tobytes())
    return LabelledSet(
        np.stack(reference),
        np.stack(frames),
        np.stack(descriptor),
        batch.force_N,
        digest.hexdigest(),
    )


def set_facts(config: Any, drawn: dict[str, LabelledSet]) -> dict[str, Any]:
    """Return what is committed before training: recipe, sensors' digests and one hash over them."""
    digests = {sensor: labelled.digest for sensor, labelled in drawn.items()}
    return {
        "recipe": asdict(config),
        "digests": digests,
        "set": config.name,
        "set_hash": set_hash(drawn),
    }


def set_hash(drawn: dict[str, LabelledSet]) -> str:
    joined = "".join(f"{sensor} {drawn[sensor].digest}\n" for sensor in sorted(drawn))
    return hashlib.sha256(joined.encode()).hexdigest()


def within(force_N: np.ndarray, bounds: ForceRange = PAPER_RANGE) -> np.ndarray:
    """Return which forces (..., 3) lie in the paper's range: 0–12 N normal, ±3 N shear."""
    shear = np.abs(force_N[..., :2]).max(axis=-1)
    return (shear <= bounds.shear_N) & (force_N[..., 2] <= bounds.normal_N)


ARRAYS = tuple(f.name for f in fields(LabelledSet) if f.name != "digest")


def cached(
    folder: Path,
    settings: Any,
    sensor: str,
    side: int,
    draw: Callable[[], LabelledSet],
    zoom: tuple[float, float] = (1.0, 1.0),
) -> LabelledSet:
    """Return the set that was kept in ``folder`` for an equal recipe, else draw and keep it.

    Only the recipe and the zoom to nominal scale are compared: after a change of the contact model
    or the canonicalizer use another folder.
    """
    zoomed = [] if zoom == (1.0, 1.0) else [zoom]
    recipe = json.dumps([asdict(settings), sensor, side, *zoomed], sort_keys=True)
    name = f"{settings.name}_{sensor}_{hashlib.sha256(recipe.encode()).hexdigest()[:12]}.npz"
    path = folder / name
    if not path.exists():
        drawn = draw()
        folder.mkdir(parents=True, exist_ok=True)
        scratch = path.with_suffix(".tmp.npz")
        arrays = {name: getattr(drawn, name) for name in ARRAYS}
        np.savez(scratch, digest=np.array(drawn.digest), **arrays)  # type: ignore
        scratch.replace(path)
    stored = read_arrays(path, (*ARRAYS, "digest"))
    return LabelledSet(**{a: stored[a] for a in ARRAYS}, digest=str(stored["digest"]))
