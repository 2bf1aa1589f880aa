"""Four-branch reconstructions: one finger's latent redraws what it saw, and what the other one saw (paper, Q2).

Pairs are drawn afresh at full size, with unseen indenters and units.  Beside every branch stand two anchors: *copy*,
the reference passed off as the reconstruction (what a decoder scores that ignores z), and *finder*, the true image
sent through the same marker finder (what a perfect decoder would score at this resolution).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch

from benchmarks.probes.hard_sets import draw_hard_pairs, pairs_digest
from uniforce_vtla.contact.indenters import UNSEEN
from uniforce_vtla.contact.pairs import PairBatch, PairSettings, equilibrium_pairs
from uniforce_vtla.contact.virtual import GELSIGHT_D, as_virtual
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE, Finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.markers.mirror import to_canonical
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.descriptor import find_blobs, marker_pitch_px, match
from uniforce_vtla.tokenizer.entry import prepare
from uniforce_vtla.tokenizer.losses import LossConfig, gradient_pyramid
from uniforce_vtla.tokenizer.pair_cache import RIGS

FINGER_OF: dict[str, Finger] = {"L": "left", "R": "right"}
BRANCHES = (("L", "L"), ("R", "L"), ("R", "R"), ("L", "R"))  # (latent from, drawn on), self before cross


@dataclass(frozen=True)
class ReconstructionConfig:
    """What is drawn and how markers are found again."""

    rigs: tuple[tuple[str, str], ...] = RIGS  # (left, right) sensors
    pairs: int = 64  # per rig
    pairs_per_unit: int = 8  # then two other units take over
    seed: int = 41_001  # of everything drawn
    indenters: tuple[str, ...] = UNSEEN  # names drawn from
    threshold: float = 0.5  # of white; of .3, .4 and .5 the one that finds true images' own markers best
    pyramid_levels: int = LossConfig().pyramid_levels  # of the perceptual term, as in training
    hard: bool = True  # also the frozen pairs that don't fit (hard_sets.py)


@dataclass(frozen=True)
class Rig:
    """One rig's pairs and what the decoder made of them, everything in the canonical frame.

    Attributes:
        sensors: (left, right) names.
        reference, current: side "L" or "R" → (n, S, S) float32 in [0, 1], as the model sees them.
        full: side → (n, 480, 640) uint8 current images.
        drawn: branch "L->R" → (n, S, S); z inferred from L, drawn on R's reference.
        force_N: (n, 3).
        indenters: (n,) names.
    """

    sensors: tuple[str, str]
    reference: dict[str, np.ndarray]
    current: dict[str, np.ndarray]
    full: dict[str, np.ndarray]
    drawn: dict[str, np.ndarray]
    force_N: np.ndarray
    indenters: tuple[str, ...]


def draw_rigs(config: ReconstructionConfig) -> list[tuple[tuple[str, str], PairBatch]]:
    """Return full-size equilibrium pairs per rig; they depend on the config alone."""
    settings = PairSettings(flat_share=0.0, pairs_per_unit=config.pairs_per_unit)
    return [
        (
            rig,
            equilibrium_pairs(
                np.random.default_rng([config.seed, number]),
                config.pairs,
                *rig,
                config.indenters,
                None,
                settings,
            ),
        )
        for number, rig in enumerate(config.rigs)
    ]


def draw_hard_rigs() -> list[tuple[tuple[str, str], PairBatch]]:
    """Return frozen pairs that don't fit: a gel nobody pretrained on, fingers misaligned and out of balance."""
    tactip = as_virtual("tactip")
    return [
        ((left.name, "tactip"), draw_hard_pairs(left, tactip)) for left in (GELSIGHT_D, as_virtual("uskin"))
    ]


def reconstruct(tokenizer: Tokenizer, sensors: tuple[str, str], pairs: PairBatch) -> Rig:
    """Return all four reconstructions of a batch of pairs."""
    references = {"L": pairs.left_reference, "R": pairs.right_reference}
    currents = {"L": pairs.left_current, "R": pairs.right_current}
    side = tokenizer.config.side
    z = {s: tokenizer.encode(references[s], currents[s], FINGER_OF[s]) for s in FINGER_OF}  # (n, P, L) each
    drawn = {
        branch_name(i, j): tokenizer.decode(references[j], z[i], FINGER_OF[j]).numpy() for i, j in BRANCHES
    }

    def seen(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {s: prepare(images[s], FINGER_OF[s], side)[:, 0].numpy() for s in FINGER_OF}

    full = {s: to_canonical(currents[s], FINGER_OF[s]) for s in FINGER_OF}
    return Rig(sensors, seen(references), seen(currents), full, drawn, pairs.force_N, pairs.indenters)


def branch_name(source: str, target: str) -> str:
    """Return e.g. ``L->R``: latent from the left finger, drawn on the right one's reference."""
    return f"{source}->{target}"


def full_size(image: np.ndarray, threshold: float) -> np.ndarray:
    """Return a (480, 640) binary image of a (S, S) grey one in [0, 1]: enlarged, un-letterboxed, thresholded."""
    rows, columns = MARKER_IMAGE_SHAPE
    large = cv2.resize(image, (columns, columns), interpolation=cv2.INTER_CUBIC)
    top = (columns - rows) // 2
    return np.where(large[top : top + rows] > threshold, 255, 0).astype(np.uint8)


def marker_error(said: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Return how well the markers of a binary image lie on the true ones.

    Markers are matched as mutual nearest neighbours closer than half the true pitch; beyond that a neighbour would
    be taken for the marker itself.  What has no match isn't dropped but counted.

    Args:
        said: (480, 640) uint8 in {0, 255}.
        truth: likewise; holds at least two markers.

    Returns:
        ``distance_px`` mean over matches (NaN without any), ``matched``, ``missed``, ``spurious``, ``markers``.

    Raises:
        ContractError: a truth with fewer than two markers.
    """
    before, after = find_blobs(truth), find_blobs(said)
    if len(before.area_px) < 2:
        raise ContractError(expected("true image", "two markers or more", len(before.area_px), "Draw again."))
    i, j = match(before, after, marker_pitch_px(before.centre_px) / 2)
    distance = np.linalg.norm(before.centre_px[i] - after.centre_px[j], axis=1)
    return {
        "distance_px": float(distance.mean()) if len(i) else float("nan"),
        "matched": float(len(i)),
        "missed": float(len(before.area_px) - len(i)),
        "spurious": float(len(after.area_px) - len(i)),
        "markers": float(len(before.area_px)),
    }


def image_errors(
    said: np.ndarray, rig: Rig, side: str, config: ReconstructionConfig
) -> dict[str, np.ndarray]:
    """Return per image (n,) errors of grey images ``said`` (n, S, S) against what finger ``side`` saw.

    ``l1`` mean absolute grey level, ``perceptual`` gradient pyramid, and everything of ``marker_error``.
    """
    truth = rig.current[side]
    pyramid = [
        float(gradient_pyramid(_batch(a), _batch(b), config.pyramid_levels))
        for a, b in zip(said, truth, strict=True)
    ]
    found = [
        marker_error(full_size(image, config.threshold), full)
        for image, full in zip(said, rig.full[side], strict=True)
    ]
    errors = {"l1": np.abs(said - truth).mean(axis=(1, 2)), "perceptual": np.array(pyramid)}
    return errors | {key: np.array([row[key] for row in found]) for key in found[0]}


def summarise(errors: dict[str, np.ndarray]) -> dict[str, float | int | None]:
    """Return means over images; marker distances over all matched markers, shares over all markers."""
    matched, markers = errors["matched"].sum(), errors["markers"].sum()
    travelled = np.nansum(errors["distance_px"] * errors["matched"])
    return {
        "l1": float(errors["l1"].mean()),
        "l1_sd": float(errors["l1"].std()),
        "perceptual": float(errors["perceptual"].mean()),
        "perceptual_sd": float(errors["perceptual"].std()),
        "marker_px": float(travelled / matched) if matched else None,
        "missed_share": float(errors["missed"].sum() / markers),
        "spurious_share": float(errors["spurious"].sum() / markers),
        "markers": int(markers),
        "images": len(errors["l1"]),
    }


def reconstruction_report(
    tokenizer: Tokenizer, config: ReconstructionConfig | None = None
) -> tuple[dict[str, Any], list[Rig]]:
    """Return Q2's numbers, and the rigs for the figure.

    Returns:
        ``rigs`` {"gelsight+tactip": {"branches", "copy", "finder", "cross_over_self", "worst"}}; ``worst`` are the
        pairs with the greatest cross error, worst first.  ``hard_rigs`` likewise for the frozen pairs that don't fit.
    """
    config = config or ReconstructionConfig()
    rigs = [reconstruct(tokenizer, sensors, pairs) for sensors, pairs in draw_rigs(config)]
    hard = {}
    for sensors, pairs in draw_hard_rigs() if config.hard else []:
        report = rig_report(reconstruct(tokenizer, sensors, pairs), config)
        hard["+".join(sensors)] = report | {"digest": pairs_digest(pairs), "pairs": len(pairs.force_N)}
    return {
        "what": "simulated equilibrium pairs; unseen indenters and units; px of the 640×480 image",
        "seed": config.seed,
        "pairs_per_rig": config.pairs,
        "indenters": list(config.indenters),
        "threshold": config.threshold,
        "tokenizer_hash": tokenizer.hash,
        "rigs": {"+".join(rig.sensors): rig_report(rig, config) for rig in rigs},
        "hard_rigs": hard,
    }, rigs


def rig_report(rig: Rig, config: ReconstructionConfig) -> dict[str, Any]:
    """Return one rig's errors, anchors and ratios."""
    branches = {
        branch_name(i, j): summarise(image_errors(rig.drawn[branch_name(i, j)], rig, j, config))
        for i, j in BRANCHES
    }
    return {
        "branches": branches,
        "copy": {s: summarise(image_errors(rig.reference[s], rig, s, config)) for s in FINGER_OF},
        "finder": {s: summarise(image_errors(rig.current[s], rig, s, config)) for s in FINGER_OF},
        "cross_over_self": {
            "L": _ratios(branches["R->L"], branches["L->L"]),
            "R": _ratios(branches["L->R"], branches["R->R"]),
        },
        "worst": _worst(rig, 3),
    }


def cross_error(rig: Rig) -> np.ndarray:
    """Return (n,) how bad a pair's two cross branches are: L1 over that of copying on average, summed."""
    total = np.zeros(len(rig.force_N))
    for source, target in (("R", "L"), ("L", "R")):
        truth = rig.current[target]
        copied = np.abs(rig.reference[target] - truth).mean()
        total += np.abs(rig.drawn[branch_name(source, target)] - truth).mean(axis=(1, 2)) / copied
    return total


def by_cross_error(rig: Rig) -> list[int]:
    """Return the pairs' indices, worst cross reconstruction first."""
    return [int(index) for index in np.argsort(-cross_error(rig), kind="stable")]


def _worst(rig: Rig, count: int) -> list[dict[str, Any]]:
    error = cross_error(rig)
    return [
        {
            "pair": index,
            "indenter": rig.indenters[index],
            "force_N": [float(v) for v in rig.force_N[index]],
            "cross_error": float(error[index]),
        }
        for index in by_cross_error(rig)[:count]
    ]


def _ratios(cross: dict[str, Any], own: dict[str, Any]) -> dict[str, float | None]:
    keys = ("l1", "perceptual", "marker_px")
    return {key: cross[key] / own[key] if cross[key] and own[key] else None for key in keys}


def _batch(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image)[None, None]
