"""Translation row: the source's marker images redrawn as each target's, and a force model trained on those.

The idea of GenForce (marker-to-marker translation, then a force model per target) in a small version of our own:
a U-Net instead of latent diffusion. It is *not* zero-shot: it needs the target's pictures of the same contacts,
and a model per target. It needs no label of the target.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812

from benchmarks.baselines.cells import Pictures, Predictor, Scores, add_score, labels, pictures
from benchmarks.baselines.resnet import ResNetConfig, fit_pictures
from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import Cells, Table, mean_cells


@dataclass(frozen=True)
class TranslationConfig:
    """Sizes and training of the translator, and the force model behind it."""

    # pixels per side folded into channels: a marker's subpixel shift stays, convolutions are few
    cell: int = 4
    widths: tuple[int, ...] = (48, 64, 96)  # channels per level, each half as wide as the one before
    steps: int = 600  # optimiser steps
    batch: int = 32  # frames per step
    learning_rate: float = 1e-3  # AdamW, cosine to zero
    changed_pixel_weight: float = 10.0  # extra weight where the target differs from its reference
    force: ResNetConfig = field(default_factory=ResNetConfig)


class ConvPair(nn.Module):
    """Two 3×3 convolutions with group norm."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for channels in (inputs, outputs):
            layers += [nn.Conv2d(channels, outputs, 3, padding=1), nn.GroupNorm(8, outputs), nn.SiLU()]
        self.layers = nn.Sequential(*layers)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return (B, outputs, H, W)."""
        return self.layers(maps)


class Translator(nn.Module):
    """Source reference and current, target reference → what the target would show."""

    def __init__(self, config: TranslationConfig) -> None:
        super().__init__()
        self.fold = nn.PixelUnshuffle(config.cell)
        sizes = [3 * config.cell**2, *config.widths]
        self.down = nn.ModuleList(ConvPair(a, b) for a, b in pairwise(sizes))
        pairs = list(pairwise(config.widths))
        self.up = nn.ModuleList(ConvPair(a + b, a) for a, b in reversed(pairs))
        self.draw = nn.Sequential(
            nn.Conv2d(config.widths[0], config.cell**2, 3, padding=1), nn.PixelShuffle(config.cell)
        )
        nn.init.zeros_(self.draw[0].weight)  # starts from the target's reference itself
        nn.init.zeros_(self.draw[0].bias)

    def forward(
        self, source_reference: torch.Tensor, current: torch.Tensor, target_reference: torch.Tensor
    ) -> torch.Tensor:
        """Return (B, 1, S, S) from three images of that shape."""
        maps = self.fold(torch.cat([source_reference, current, target_reference], dim=1))
        kept = []
        for index, level in enumerate(self.down):
            maps = level(F.avg_pool2d(maps, 2) if index else maps)
            kept.append(maps)
        for level, skip in zip(self.up, kept[-2::-1], strict=True):
            maps = level(torch.cat([skip, F.interpolate(maps, size=skip.shape[2:])], dim=1))
        return target_reference + self.draw(maps)


def genforce_style_row(table: Table, seeds: int, config: TranslationConfig | None = None) -> Cells:
    """Return the row: per transfer a translator and a force model of its own; no cell within one sensor.

    The training sets of both sensors must hold the same contacts in the same order (one recipe, one seed).
    """
    config = config or TranslationConfig()
    scores: Scores = {}
    for source, target in table.transfers():
        paired = pictures(table.training[target])
        for seed in range(seeds):
            predict = fit_translated(table.training[source], paired, config, seed)
            add_score(scores, table, (source, target), predict)
    return mean_cells(scores)


def fit_translated(source: LabelledSet, paired: Pictures, config: TranslationConfig, seed: int) -> Predictor:
    """Return a force predictor for the target's pictures, from source labels and paired pictures alone."""
    shown, force_N = pictures(source), labels(source)
    translator, _ = train_translator(shown, paired, config, seed)
    redrawn = translate(translator, shown, paired.reference, config.force.training.device)
    return fit_pictures(redrawn, force_N, config.force, seed)


def train_translator(
    source: Pictures, target: Pictures, config: TranslationConfig, seed: int
) -> tuple[Translator, list[float]]:
    """Return a translator and its loss per step; row and frame numbers of both sets name the same contact.

    A loss of 1 is what the target's reference itself would score: below it, something was learnt. Pictures must be
    divisible by ``cell`` and once more by 2 per level beyond the first.
    """
    device = config.force.training.device
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = Translator(config).to(device)
    optimizer = torch.optim.AdamW(model.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.steps)
    rng = np.random.default_rng(seed)
    losses = []
    for _ in range(config.steps):
        loss = _loss(model, _batch(rng, source, target, config.batch, device), config)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(loss.item())
    return model.eval(), losses


@torch.no_grad()
def translate(model: Translator, source: Pictures, target_reference: np.ndarray, device: str) -> Pictures:
    """Return the source's frames as the target would show them, with the target's references (n, S, S)."""
    drawn = np.empty_like(source.frames)
    for row in range(len(source.frames)):
        before, frames = source.tensors(slice(row, row + 1))
        goal = torch.from_numpy(target_reference[row]).float()[None, None] / 255
        current = frames[0][:, None].to(device)  # (T, 1, S, S)
        image = model(before.to(device).expand_as(current), current, goal.to(device).expand_as(current))
        drawn[row] = (image[:, 0].clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
    return Pictures(target_reference, drawn)


def _batch(rng: np.random.Generator, source: Pictures, target: Pictures, size: int, device: str) -> list[torch.Tensor]:
    """Return source reference, source current, target reference, target current, (B, 1, S, S) each."""
    n, length = source.frames.shape[:2]
    row, frame = rng.integers(n, size=size), rng.integers(length, size=size)
    images = (source.reference[row], source.frames[row, frame], target.reference[row], target.frames[row, frame])
    return [torch.from_numpy(i)[:, None].to(device).float() / 255 for i in images]


def _loss(model: Translator, batch: list[torch.Tensor], config: TranslationConfig) -> torch.Tensor:
    """Return weighted L1 over what copying the target's reference would score."""
    *given, truth = batch
    copied = (truth - given[2]).abs()
    weight = 1 + config.changed_pixel_weight * copied
    error = (weight * (model(*given) - truth).abs()).mean()
    return error / (weight * copied).mean().clamp_min(1e-4)  # a batch without contact has nothing to learn
