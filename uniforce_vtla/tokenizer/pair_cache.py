"""Pretraining data: equilibrium pairs drawn once, area-resized, as uint8 shards.

⟨GelSight, TacTip⟩ and ⟨uSkin, TacTip⟩, TacTip on the right finger (UniForce paper, "Data Collection Protocol"); a share
of the cameras may be procedural instead (tokenizer/family.py), always paired by equal traction.
"""

import json
from collections.abc import Sequence
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
from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.entry import letterbox
from uniforce_vtla.tokenizer.family import draw_dome, draw_flat
from uniforce_vtla.tokenizer.settings import PairCacheConfig

RIGS = (("gelsight", "tactip"), ("uskin", "tactip"))
FAMILIES = {"gelsight": draw_flat, "tactip": draw_dome}
NAMES = ("left_reference", "right_reference", "left_current", "right_current")


@dataclass(frozen=True)
class Pairs:
    """A batch of pairs in the canonical frame, ready for the model."""

    left_reference: torch.Tensor  # (U, 1, S, S) float32 in [0, 1], one per unit
    right_reference: torch.Tensor
    left_current: torch.Tensor  # (U·n, 1, S, S), unit by unit
    right_current: torch.Tensor


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
        references = [self.arrays[name][unit] for name in NAMES[:2]]
        return _canonical(
            *references, *(self.arrays[name][unit[:, None], contact] for name in NAMES[2:])
        )


class RecordedPairs:
    """Recorded grasps in memory, each with its own references; draws training batches of some of them.

    Args:
        recordings: images of each by ``NAMES``, as the sensors saw them: references (S, S), currents (n, S, S) uint8.

    Raises DatasetError: no recording.
    """

    def __init__(self, recordings: Sequence[dict[str, np.ndarray]]) -> None:
        if not recordings:
            raise DatasetError(
                expected("recorded pairs", "one grasp or more", "none", "Record some.")
            )
        self._recordings = recordings

    def draw(self, rng: np.random.Generator, units: int, pairs: int) -> Pairs:
        """Return ``units`` random grasps with ``pairs`` random moments each; some may come twice."""
        chosen = [self._recordings[k] for k in rng.integers(len(self._recordings), size=units)]
        moment = [rng.integers(len(recording["left_current"]), size=pairs) for recording in chosen]
        references = [np.stack([recording[name] for recording in chosen]) for name in NAMES[:2]]
        rows = list(zip(chosen, moment, strict=True))
        return _canonical(
            *references, *(np.stack([r[name][row] for r, row in rows]) for name in NAMES[2:])
        )


def build_cache(folder: Path, config: PairCacheConfig) -> None:
    """Draw the shards that are not there yet; raises DatasetError: the folder holds a cache of another config."""
    folder.mkdir(parents=True, exist_ok=True)
    _check_or_write_config(folder / "config.json", config)
    chosen = rigs(config)
    for number, path in enumerate(tqdm(_shard_paths(folder, config), desc="drawing pairs")):
        if not path.exists():
            rng, rig = np.random.default_rng([config.seed, number]), chosen[number % len(chosen)]
            batches = [_draw_unit(rng, config, rig) for _ in range(config.units_per_shard)]
            scratch = path.with_suffix(".tmp.npz")
            np.savez(scratch, **_stacked(batches))  # type: ignore[arg-type]
            scratch.replace(path)


def rigs(config: PairCacheConfig) -> tuple[tuple[str, str], ...]:
    """Return the rigs that pairs are drawn of, left and right finger: those without the kind that is left out."""
    return tuple(rig for rig in RIGS if config.left_out not in rig)


def shrink(images: np.ndarray, side: int) -> np.ndarray:
    """Return (B, side, side) uint8 of (B, H, W) images: the tokenizer's own resize, without its mirror."""
    small = letterbox(torch.from_numpy(images)[:, None].float(), side)[:, 0]
    return small.round().to(torch.uint8).numpy()


def _stacked(batches: list[PairBatch]) -> dict[str, np.ndarray]:
    """Return units' images by name: one reference (U, S, S) and all currents (U, n, S, S) of each unit."""
    references = {name: np.stack([getattr(b, name)[0] for b in batches]) for name in NAMES[:2]}
    return references | {name: np.stack([getattr(b, name) for b in batches]) for name in NAMES[2:]}


def _canonical(*images: np.ndarray) -> Pairs:
    """Return a batch for the model from images (…, S, S) uint8 by ``NAMES``, as the sensors saw them."""
    flat = [
        torch.from_numpy(np.ascontiguousarray(i.reshape(-1, 1, *i.shape[-2:]))).float() / 255
        for i in images
    ]
    return Pairs(
        *(
            to_canonical(i, "left" if "left" in name else "right")
            for name, i in zip(NAMES, flat, strict=True)
        )
    )


def _draw_unit(
    rng: np.random.Generator, config: PairCacheConfig, rig: tuple[str, str]
) -> PairBatch:
    left, right = (draw_finger(rng, sensor, config) for sensor in rig)
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
    """Return ``sensor``, or with probability ``family_share`` a procedural one of its kind (cameras only)."""
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
    first = read_arrays(paths[0], NAMES)
    units = len(first["left_reference"])
    arrays = {n: np.empty((units * len(paths), *a.shape[1:]), a.dtype) for n, a in first.items()}
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
