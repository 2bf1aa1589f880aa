"""Rows of published encoders: frozen, seen through the same head; "n/a" where their weights aren't on disk."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.baselines.cells import check_seeds
from benchmarks.baselines.pictures import pictures
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import POOL, Cells, Table, learnt_row
from uniforce_vtla.errors import ContractError, expected

MEASURED, NOT_PRESENT = "measured", "n/a: weights not present"
BATCH = 16  # frames encoded at once: ViT-L at 224² needs about 1 GB for them


@dataclass(frozen=True)
class Brightness:
    """Mean and spread of a set's pictures, values in [0, 1]."""

    mean: float
    std: float


class PublishedEncoder(nn.Module):
    """A published encoder. Subclasses say how a marker image becomes its input, and its input a map of tokens."""

    name: str  # as in the table
    config: Any  # its sizes; the one argument of every subclass that must be given
    input_size: tuple[int, int]  # height, width [px]

    def prepare(self, images: torch.Tensor, brightness: Brightness) -> torch.Tensor:
        """Return the input (B, 3, H, W) for grey images (B, S, S) in [0, 1]."""
        raise NotImplementedError

    def token_map(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return tokens as a map (B, L, h, w) for inputs (B, 3, H, W)."""
        raise NotImplementedError

    def forward(self, images: torch.Tensor, brightness: Brightness) -> torch.Tensor:
        """Return (B, POOL², L): token means over regions, as the table keeps of our latent too."""
        tokens = self.token_map(self.prepare(images, brightness))
        return F.adaptive_avg_pool2d(tokens, POOL).flatten(2).transpose(1, 2)


@dataclass(frozen=True)
class PublishedRow:
    """One row and what stands beside it."""

    status: str  # MEASURED or NOT_PRESENT
    cells: Cells | None  # the row's cells; None if there are no weights
    facts: dict[str, Any]  # weights used, parameters, FLOPs per frame, for the results file

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        return {"status": self.status, "cells": self.cells, **self.facts}


def measured_row(
    encoder: PublishedEncoder, table: Table, seeds: int, weights: str, device: str = "cpu"
) -> PublishedRow:
    """Return the row of a loaded encoder: frozen, same pooling, same head as ours."""
    check_seeds(seeds)
    cells = learnt_row(table, lambda labelled: features(encoder, labelled, device), seeds, POOL)
    return PublishedRow(MEASURED, cells, {"weights": weights} | size_facts(encoder))


def missing_row(encoder: PublishedEncoder) -> PublishedRow:
    """Return the row of an encoder without weights: its size, no score. ``encoder`` may be on the meta device."""
    return PublishedRow(NOT_PRESENT, None, {"weights": None} | size_facts(encoder))


@torch.no_grad()
def features(encoder: PublishedEncoder, labelled: LabelledSet, device: str = "cpu") -> torch.Tensor:
    """Return (n, T, POOL², L) of a labelled set's current frames; these encoders take one frame, no reference.

    Raises:
        ContractError: images of another form, or an encoder on the meta device (it has no weights).
    """
    if next(encoder.parameters()).is_meta:
        raise ContractError(expected(encoder.name, "loaded weights", "a meta model", "Use its load function."))
    shown = pictures(labelled)
    brightness = brightness_of(labelled)
    encoder = encoder.to(device).eval()
    n, length = shown.frames.shape[:2]
    flat = torch.from_numpy(shown.frames).flatten(0, 1)  # (n·T, S, S) uint8
    rows = [encoder(part.to(device).float() / 255, brightness).cpu() for part in flat.split(BATCH)]
    return torch.cat(rows).unflatten(0, (n, length))


def brightness_of(labelled: LabelledSet) -> Brightness:
    """Return mean and spread over all current frames; no label is involved."""
    values = labelled.frames.astype("float32") / 255
    # a black set must not divide by 0
    return Brightness(float(values.mean()), max(float(values.std()), 1e-3))


def size_facts(encoder: PublishedEncoder) -> dict[str, Any]:
    """Return ``params`` and ``flops_per_frame``."""
    return {
        "params": sum(p.numel() for p in encoder.parameters()),
        "flops_per_frame": count_flops(encoder),
        "input_px": list(encoder.input_size),
    }


def count_flops(encoder: PublishedEncoder) -> int:
    """Return floating point operations (2 per multiply-add) for one frame.

    Counted on the meta device: the counter has no entry for the CPU's fused attention and would leave it out.
    """
    shadow = encoder if next(encoder.parameters()).is_meta else _on_meta(encoder)
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        shadow.token_map(torch.empty(1, 3, *encoder.input_size, device="meta"))
    return int(counter.get_total_flops())


def grey_to_rgb(images: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Return (B, 3, H, W): resized with antialiasing, one channel three times."""
    resized = F.interpolate(images[:, None], size, mode="bilinear", align_corners=False, antialias=True)
    return resized.expand(-1, 3, -1, -1)


def _on_meta(encoder: PublishedEncoder) -> PublishedEncoder:
    with torch.device("meta"):
        return type(encoder)(encoder.config)
