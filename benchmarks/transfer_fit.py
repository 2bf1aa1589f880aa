"""Simulated grasps for every sensor on either finger, and the maps between their latents that are fitted to them.

Statics shares the force of a grasp equally between its fingers; how torsion about the closing axis is shared hangs on
both pads, and a couple about the other axes pushes the fingers apart sideways: an eraser grasped a little turned stays
wedged between pads that stick. In the wiping scene the fingers' forces along the pad's height differ by .5 N from
episode to episode, sideways by up to 4 N, and their torsions by 50 Nmm, as much as each of them is.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from torch import Tensor

from uniforce_vtla.contact.indenters import PRETRAIN
from uniforce_vtla.contact.pairs import PairSettings, finger_views
from uniforce_vtla.contact.sampling import ForceRange, sample_loads
from uniforce_vtla.contact.simulator import Transform
from uniforce_vtla.contracts import ContactState
from uniforce_vtla.options import Count, NotNegative, Positive, Seed, Share, Sizes
from uniforce_vtla.tokenizer.latent import MOST_DIRECTIONS
from uniforce_vtla.tokenizer.sensor_transfer import SensorTransfer

SMALLEST = 0.1  # amplitude below which differences say nothing of the noise
SHRINKAGE = 1e-3  # of the spread within a grasp: numbers that never vary must not look agreed upon
Views = list[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class OtherFinger:
    """How the second finger's load differs from the first's."""

    own_side: bool = True  # sideways (x) force drawn anew within friction; False: as the first finger's
    own_torsion: bool = True  # likewise


def two_fingers(
    rng: np.random.Generator,
    blocks: int,
    sensors: Sequence[str],
    settings: PairSettings,
    other: OtherFinger,
    transform: Transform | None = None,
) -> Iterator[tuple[Views, Views]]:
    """Yield ``blocks`` times what ``settings.pairs_per_unit`` grasps look like to fresh units of each sensor.

    All as the left finger sees them, the second finger's contacts too: nothing is mirrored.

    Yields:
        first and second finger; of each, per sensor, the reference (480, 640) and the currents (n, 480, 640), or what
        ``transform`` made of them.
    """
    n = settings.pairs_per_unit
    for _ in range(blocks):
        objects = settings.objects(rng, n, PRETRAIN)
        force, torsion = sample_loads(rng, n, settings.force_range, objects.names)
        loads = (force, torsion), _shared(rng, force, torsion, settings.force_range, other)
        first, second = (ContactState(objects.gap_mm, *load) for load in loads)
        yield (
            _seen(rng, sensors, first, settings, transform),
            _seen(rng, sensors, second, settings, transform),
        )


def _shared(
    rng: np.random.Generator, force: np.ndarray, torsion: np.ndarray, bounds: ForceRange, other: OtherFinger
) -> tuple[np.ndarray, np.ndarray]:
    """Return the second finger's force (n, 3) and torsion (n,)."""
    force, room = force.copy(), bounds.friction * force[:, 2]
    if other.own_side:
        widest = np.sqrt(np.maximum(room**2 - force[:, 1] ** 2, 0))
        force[:, 0] = rng.uniform(-1, 1, len(widest)) * widest
    if other.own_torsion:
        own = rng.uniform(-1, 1, len(torsion)) * room * bounds.flat_torsion_arm_mm
        torsion = own.astype(torsion.dtype)
    return force, torsion


def _seen(
    rng: np.random.Generator,
    sensors: Sequence[str],
    contact: ContactState,
    settings: PairSettings,
    transform: Transform | None,
) -> Views:
    views = [finger_views(rng, sensor, contact, settings, transform) for sensor in sensors]
    return [(references[0], currents) for references, currents in views]


@dataclass(frozen=True)
class SensorTransferFit:
    """How the grasps are drawn and the maps fitted."""

    grasps: Count = 4096  # each drawn for every sensor on either finger; about a minute per thousand
    flat_share: Share = 1.0  # all held tools: what a policy meets
    # a held tool that wipes twists flat pads so much (contact/sampling.py)
    flat_torsion_arm_mm: NotNegative = 9.0
    flat_side_mm: Sizes = (30.0, 70.0)  # a held tool covers the pad; 12–40 bent the reading of GelSight
    # what parallel fingers hold lies flat on both pads but for their give (a wiped eraser leans by .01, a wedged one by
    # up to .046); a flat gel shows a leaning face as less grip: with .03 or .045 a finger that swaps to GelSight reads
    # 1.2 to 1.7 N too much grip, and no less by scene
    flat_tilt_rad: NotNegative = 0.015
    other: OtherFinger = field(default_factory=OtherFinger)  # what fingers of a grasp don't share
    grid: Count = 4  # latents pooled to grid × grid, as policies read them
    ridge: Positive = 30.0  # grasps' worth of belief that fingers agree
    held_out: Share = 0.2  # share of the grasps that only judge, and give the noise
    seed: Seed = 1  # of everything drawn


@dataclass(frozen=True)
class GraspLatents:
    """A sensor's latents of N grasps: ``first``, ``second`` finger (N, K, L) pooled, ``rest`` (K, L) in free air."""

    first: np.ndarray
    second: np.ndarray
    rest: np.ndarray


def fit_transfer(
    latents: Mapping[str, GraspLatents], tokenizer_hash: str, config: SensorTransferFit
) -> tuple[SensorTransfer, dict[str, Any]]:
    """Return the maps and how well they predict, on grasps held out.

    Args:
        latents: sensor → its latents of the same grasps on either finger.
        tokenizer_hash: whose latents they are.
        config: how they were drawn; ridge and share held out.
    """
    kinds = list(latents)
    count, rows, size = latents[kinds[0]].first.shape
    transfer = SensorTransfer(kinds, rows * size, tokenizer_hash)
    cells = {}
    for i, source in enumerate(kinds):
        before, spread = latents[source].first.reshape(count, -1), _spread(latents[source].first)
        rest = latents[source].rest.reshape(-1)
        amplitude = np.sqrt(np.square((before - rest) / spread).mean(axis=1))
        transfer.rest[i], transfer.unit[i] = _tensor(rest), _tensor(spread * amplitude.mean())
        for j, target in enumerate(kinds):
            after = latents[target].second.reshape(count, -1)
            maps, cells[f"{source}->{target}"] = _fit(before, after, spread, amplitude / amplitude.mean(), config)
            for name, values in maps.items():
                getattr(transfer, name)[i, j] = _tensor(values)
    fingers = [finger.reshape(count, -1) for own in latents.values() for finger in (own.first, own.second)]
    matrix, ratios = agreed_directions(fingers)
    transfer.directions.copy_(_tensor(matrix))
    transfer.origin.copy_(_tensor(np.mean([own.rest.reshape(-1) for own in latents.values()], axis=0) @ matrix))
    transfer.disagreement.copy_(_tensor(1 / np.sqrt(ratios)))
    agreement = [round(float(ratio), 1) for ratio in ratios]
    return transfer, {"config": asdict(config), "differences": cells, "agreement": agreement}


def agreed_directions(fingers: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (n, MOST_DIRECTIONS) by falling agreement, and variance between over variance within grasps.

    Along them grasps differ much and fingers of one grasp little: linear discriminants, a grasp a class. They hold the
    force that fingers share; their torsion, their sensors and units differ. No force label is used. Latents times
    directions have spread 1 over grasps.

    Args:
        fingers: latents (N, n) of the same N grasps, one array per finger and sensor; at least two.
    """
    latents = np.stack(fingers).astype(np.float64)  # (F, N, n)
    count, grasps = latents.shape[:2]
    analysis = LinearDiscriminantAnalysis(solver="eigen", shrinkage=SHRINKAGE)
    analysis.fit(latents.reshape(count * grasps, -1), np.tile(np.arange(grasps), count))
    scalings, grasp = analysis.scalings_[:, :MOST_DIRECTIONS], latents.mean(axis=0)
    between = (grasp @ scalings).var(axis=0, ddof=1)
    within = np.square((latents - grasp) @ scalings).sum(axis=(0, 1)) / (grasps * (count - 1))
    return scalings / np.sqrt(between), between / within


def _fit(
    before: np.ndarray,
    after: np.ndarray,
    spread: np.ndarray,
    amplitude: np.ndarray,
    config: SensorTransferFit,
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Fit after − before = M' before + b by ridge in units of the source's spread; the noise from what is held out."""
    mean = before.mean(axis=0, dtype=np.float64)
    x, change = (before - mean) / spread, (after - before) / spread
    learnt = int(len(x) * (1 - config.held_out))
    inputs = np.c_[x, np.ones(len(x))]
    pull = np.diag([config.ridge] * x.shape[1] + [0.0])
    weights = np.linalg.solve(inputs[:learnt].T @ inputs[:learnt] + pull, inputs[:learnt].T @ change[:learnt])
    left, held = (change - inputs @ weights)[learnt:], amplitude[learnt:]
    evened = (left / held[:, None])[held > SMALLEST]  # as if every grasp had the average one's amplitude
    noise = np.linalg.cholesky(evened.T @ evened / len(evened) + 1e-6 * np.eye(x.shape[1]))
    matrix = np.eye(x.shape[1]) + spread[:, None] * weights[:-1].T / spread[None]
    offset = mean + spread * weights[-1] - matrix @ mean
    maps = {"matrix": matrix, "offset": offset, "noise_scale": spread[:, None] * noise}
    return maps, {"rms": _rms(change[learnt:]), "rms_left": _rms(left)}  # in spreads of the source


def _spread(latents: np.ndarray) -> np.ndarray:
    """Return (n,) spread of each number over grasps, alike for all cells of a channel, as force tokens see it."""
    channels = np.sqrt((latents.astype(np.float64).std(axis=0) ** 2).mean(axis=0))  # (L,)
    return np.tile(np.maximum(channels, 1e-3), latents.shape[1])


def _rms(values: np.ndarray) -> float:
    return round(float(np.sqrt(np.mean(values**2))), 3)


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.asarray(values)).float()
