"""Force-labelled sequences for heads and for the frozen zero-shot set; the latter is named by its hash.

Every sensor gets the *same* contacts (one seed): what differs between cells of the table is the sensor alone.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.probes.sequences import force_sequences
from uniforce_vtla.array_file import read_arrays
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.contact.sampling import PAPER_RANGE, ForceRange
from uniforce_vtla.tokenizer.descriptor import describe
from uniforce_vtla.tokenizer.pair_cache import shrink

SENSORS = ("gelsight", "tactip", "uskin")


@dataclass(frozen=True)
class SetConfig:
    """What a labelled set is drawn from."""

    name: str  # for people
    seed: int  # of contacts, units and noise
    sequences: int  # per sensor, each from its own unit and indenter placement
    length: int  # frames per sequence
    indenters: tuple[str, ...]  # names drawn from
    force_range: ForceRange = field(default_factory=ForceRange)  # 16 N, ±8 N: over-pressing is read too
    flat_share: float = 0.0  # of held flat tools among the indenters


FROZEN = SetConfig("zero_shot_v2", seed=7_001, sequences=120, length=12, indenters=UNSEEN)
# half of them held tools: that is what a policy's fingers hold
HEAD_TRAINING = SetConfig("head_training_v2", seed=7_002, sequences=400, length=12, indenters=SEEN, flat_share=0.5)


@dataclass(frozen=True)
class LabelledSet:
    """One sensor's sequences, n × T frames."""

    reference: np.ndarray  # (n, S, S) uint8, area-resized
    frames: np.ndarray  # (n, T, S, S) uint8
    descriptor: np.ndarray  # (n, T, 6) float32, the hand descriptor of every frame
    force_N: np.ndarray  # (n, T, 3) canonical
    digest: str  # sha256 over full-size images and forces


def draw_labelled(config: SetConfig, sensor: str, side: int) -> LabelledSet:
    """Return ``sensor``'s sequences, at the model's size, with descriptors of the full-size images."""
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
    return LabelledSet(np.stack(reference), np.stack(frames), np.stack(descriptor), batch.force_N, digest.hexdigest())


def set_facts(config: Any, drawn: dict[str, LabelledSet]) -> dict[str, Any]:
    """Return what is committed before training: the set's recipe, its sensors' digests and one hash over them."""
    digests = {sensor: labelled.digest for sensor, labelled in drawn.items()}
    return {"recipe": asdict(config), "digests": digests, "set": config.name, "set_hash": set_hash(drawn)}


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
    """Return ``draw()``'s set from ``folder`` if an equal recipe was drawn before, else draw and keep it.

    Only the recipe and the zoom to nominal scale are compared: after a change of the contact model or the
    canonicalizer use another folder.
    """
    zoomed = [] if zoom == (1.0, 1.0) else [zoom]
    recipe = json.dumps([asdict(settings), sensor, side, *zoomed], sort_keys=True)
    name = f"{settings.name}_{sensor}_{hashlib.sha256(recipe.encode()).hexdigest()[:12]}.npz"
    path = folder / name
    if not path.exists():
        drawn = draw()
        folder.mkdir(parents=True, exist_ok=True)
        scratch = path.with_suffix(".tmp.npz")
        np.savez(scratch, digest=np.array(drawn.digest), **{a: getattr(drawn, a) for a in ARRAYS})  # type: ignore
        scratch.replace(path)
    stored = read_arrays(path, (*ARRAYS, "digest"))
    return LabelledSet(**{a: stored[a] for a in ARRAYS}, digest=str(stored["digest"]))
