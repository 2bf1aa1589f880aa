"""Pretraining data: equilibrium pairs drawn once, area-resized, as uint8 shards.

⟨GelSight, TacTip⟩ and ⟨uSkin, TacTip⟩, TacTip on the right finger (UniForce paper, "Data Collection
Protocol"). A share of the cameras may be procedural (tokenizer/family.py).
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from uniforce_vtla.array_file import read_arrays
from uniforce_vtla.contact.pairs import PairBatch, PairSettings, equilibrium_pairs
from uniforce_vtla.contact.responses import ContactOptions
from uniforce_vtla.contact.sampling import ForceRange
from uniforce_vtla.contact.units import Look
from uniforce_vtla.contact.virtual import VirtualSensor
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.entry import letterbox
from uniforce_vtla.tokenizer.family import draw_dome, draw_flat
from uniforce_vtla.tokenizer.settings import PairCacheConfig

RIGS = (("gelsight", "tactip"), ("uskin", "tactip"))
FAMILIES = {"gelsight": draw_flat, "tactip": draw_dome}
REFERENCES = ("left_reference", "right_reference")
CURRENTS = ("left_current", "right_current")
NAMES = (*REFERENCES, *CURRENTS)


@dataclass(frozen=True)
class Pairs:
    """A batch of pairs in the canonical frame, ready for the model."""

    left_reference: torch.Tensor  # (U, 1, S, S) float32 in [0, 1], one per unit
    right_reference: torch.Tensor
    left_current: torch.Tensor  # (U·n, 1, S, S), unit by unit
    right_current: torch.Tensor

    def to(self, device: torch.device) -> Pairs:
        """Return the batch on another device."""
        return Pairs(**{name: images.to(device) for name, images in vars(self).items()})


class PairCache:
    """All shards in memory; draws training batches of whole units."""

    def __init__(self, folder: Path, config: PairCacheConfig) -> None:
        build_cache(folder, config)
        self.arrays = _gathered(_shard_paths(folder, config))
        self.pairs_per_unit = config.pairs_per_unit

    def draw(self, rng: np.random.Generator, units: int, pairs: int) -> Pairs:
        """Return ``units`` random units with ``pairs`` random contacts each."""
        unit = rng.integers(len(self.arrays["left_reference"]), size=units)
        contact = np.stack([rng.permutation(self.pairs_per_unit)[:pairs] for _ in unit])  # (U, n)
        drawn = {name: self.arrays[name][unit] for name in REFERENCES}
        for name in CURRENTS:
            drawn[name] = self.arrays[name][unit[:, None], contact]
        return _canonical(drawn)


class RecordedPairs:
    """Recorded grasps in memory, each with its own references; draws training batches of them.

    Args:
        recordings: uint8 images of each by ``NAMES``, in the sensors' own frames: references
            (S, S), currents (n, S, S).

    Raises DatasetError: no recording.
    """

    def __init__(self, recordings: Sequence[dict[str, np.ndarray]]) -> None:
        if not recordings:
            raise DatasetError(
                expected("recorded pairs", "one grasp or more", "none", "Record some.")
            )
        self._recordings = recordings

    def draw(self, rng: np.random.Generator, units: int, pairs: int) -> Pairs:
        """Return ``units`` random grasps, repeats allowed, with ``pairs`` random moments each."""
        drawn = defaultdict(list)
        for k in rng.integers(len(self._recordings), size=units):
            recording = self._recordings[k]
            moment = rng.integers(len(recording["left_current"]), size=pairs)
            for name in REFERENCES:
                drawn[name].append(recording[name])
            for name in CURRENTS:
                drawn[name].append(recording[name][moment])
        return _canonical(drawn)


def build_cache(folder: Path, config: PairCacheConfig) -> None:
    """Draw the shards that are not there yet.

    Raises DatasetError: the folder holds a cache of another config.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _check_or_write_config(folder / "config.json", config)
    chosen = rigs(config)
    for number, path in enumerate(tqdm(_shard_paths(folder, config), desc="drawing pairs")):
        if path.exists():
            continue
        rng = np.random.default_rng([config.seed, number])
        drawn = defaultdict(list)
        for _ in range(config.units_per_shard):
            pairs = _draw_unit(rng, config, chosen[number % len(chosen)])
            for name in REFERENCES:
                drawn[name].append(getattr(pairs, name)[0])  # (S, S), the same in all pairs
            for name in CURRENTS:
                drawn[name].append(getattr(pairs, name))  # (n, S, S)
        scratch = path.with_suffix(".tmp.npz")
        np.savez(scratch, **drawn)  # type: ignore[arg-type]
        scratch.replace(path)


def rigs(config: PairCacheConfig) -> tuple[tuple[str, str], ...]:
    """Return the rigs that pairs are drawn of, (left, right), without the type left out."""
    return tuple(rig for rig in RIGS if config.left_out not in rig)


def shrink(images: np.ndarray, side: int) -> np.ndarray:
    """Return (B, side, side) uint8 of (B, H, W) images: the tokenizer's resize, without mirror."""
    small = letterbox(torch.from_numpy(images)[:, None].float(), side)[:, 0]
    return small.round().to(torch.uint8).numpy()


def _canonical(drawn: Mapping[str, np.ndarray | list[np.ndarray]]) -> Pairs:
    """Return a batch for the model from images (…, S, S) uint8 in the sensors' own frames."""
    return Pairs(
        _to_model(drawn["left_reference"], "left"),
        _to_model(drawn["right_reference"], "right"),
        _to_model(drawn["left_current"], "left"),
        _to_model(drawn["right_current"], "right"),
    )


def _to_model(images: np.ndarray | list[np.ndarray], finger: Finger) -> torch.Tensor:
    """Return (N, 1, S, S) float32 in [0, 1], canonical frame."""
    rows = torch.from_numpy(np.ascontiguousarray(images)).flatten(0, -3)
    return to_canonical(rows[:, None].float() / 255, finger)


def _draw_unit(
    rng: np.random.Generator, config: PairCacheConfig, rig: tuple[str, str]
) -> PairBatch:
    left = draw_finger(rng, rig[0], config)
    right = draw_finger(rng, rig[1], config)
    lossy = config.marker_loss > 0 and rng.random() < 0.5
    settings = PairSettings(
        options=ContactOptions(marker_loss=lossy, loss_probability=config.marker_loss),
        look=Look() if config.free_look else None,
        misaligned_cells=config.misaligned_cells,
        imbalance=config.imbalance,
        flat_share=config.flat_share,
        force_range=ForceRange(flat_torsion_arm_mm=config.flat_torsion_arm_mm),
    )
    shrunk = partial(shrink, side=config.side)
    return equilibrium_pairs(
        rng, config.pairs_per_unit, left, right, settings=settings, transform=shrunk
    )


def draw_finger(
    rng: np.random.Generator, sensor: str, config: PairCacheConfig
) -> str | VirtualSensor:
    """Return ``sensor``, or with probability ``family_share`` a procedural camera of its family."""
    share = config.family_share
    if sensor not in FAMILIES or share <= 0 or rng.random() >= share:
        return sensor
    return FAMILIES[sensor](rng)


def _shard_paths(folder: Path, config: PairCacheConfig) -> list[Path]:
    if config.units % config.units_per_shard:
        wanted = f"a multiple of units_per_shard={config.units_per_shard}"
        raise ContractError(expected("units", wanted, config.units, "Change one of them."))
    count = len(RIGS) * config.units // config.units_per_shard
    return [folder / f"shard_{number:03d}.npz" for number in range(count)]


def _gathered(paths: list[Path]) -> dict[str, np.ndarray]:
    """Return all shards one after another, without ever holding them twice."""
    arrays = {}
    for name, part in read_arrays(paths[0], NAMES).items():
        units = len(part)
        arrays[name] = np.empty((units * len(paths), *part.shape[1:]), part.dtype)
    for number, path in enumerate(paths):
        for name, part in read_arrays(path, NAMES).items():
            arrays[name][number * units : (number + 1) * units] = part
    return arrays


def _check_or_write_config(path: Path, config: PairCacheConfig) -> None:
    if not path.exists():
        path.write_text(json.dumps(asdict(config), indent=1))
        return
    stored = read_object(path, DatasetError)
    known = set(asdict(config)) >= set(stored)
    # options added after the cache was drawn stand at their defaults
    if not known or replace(PairCacheConfig(), **stored) != config:
        raise DatasetError(
            expected(f"cache in {path.parent}", asdict(config), stored, "Choose another folder.")
        )
