"""Pretrain the tokenizer: equilibrium pairs in, checkpoint out. Resumable, seeded, no force labels.

The same command runs on one CPU or, through ``accelerate launch``, on many GPUs. More than one
process was never tried.
"""

import csv
import math
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from accelerate import Accelerator
from tqdm import tqdm

from uniforce_vtla.errors import ContractError, DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.results_file import write_json
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.losses import Side, objective
from uniforce_vtla.tokenizer.model import ForceAutoencoder, Posterior, build_model
from uniforce_vtla.tokenizer.pair_cache import PairCache, Pairs, RecordedPairs
from uniforce_vtla.tokenizer.settings import LossConfig, PretrainSettings
from uniforce_vtla.tokenizer.weights import STATE, load_state, save_state

RECIPE = "recipe.json"  # every setting of the run, beside its state
MAY_CHANGE = ("steps", "save_every", "strips_every")  # between a run and its continuation


def with_defaults(defaults: dict[str, Any], stored: dict[str, Any]) -> dict[str, Any]:
    """Return stored settings, nested ones too, with defaults for options that were added later."""
    filled = defaults | stored
    for name, inner in defaults.items():
        if isinstance(inner, dict) and isinstance(filled[name], dict):
            filled[name] = with_defaults(inner, filled[name])
    return filled


def learning_rate(step: int, settings: PretrainSettings) -> float:
    """Return the rate at ``step``: linear warm-up, cosine decay to a fiftieth of the peak."""
    if step < settings.warmup_steps:
        return settings.learning_rate * (step + 1) / settings.warmup_steps
    done = (step - settings.warmup_steps) / max(1, settings.steps - settings.warmup_steps)
    return settings.learning_rate * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(1.0, done))))


def starting_model(settings: PretrainSettings) -> ForceAutoencoder:
    """Return the model before its first step: new, or with the weights of another run.

    Raises ContractError: that run's model has other sizes; CheckpointError: no tokenizer there.
    """
    model = build_model(settings.model, settings.seed)
    if settings.init:
        earlier = Tokenizer.from_pretrained(settings.init)
        if earlier.config != settings.model:
            do = "Give it the same sizes."
            raise ContractError(
                expected(f"model of {settings.init}", settings.model, earlier.config, do)
            )
        model.load_state_dict(earlier.model.state_dict())
    return model


class Pretraining:
    """A run in ``folder``: continues from its last checkpoint.

    Every step draws its batch and noise from (seed, step), so that a resumed run equals an
    uninterrupted one.
    """

    def __init__(
        self, settings: PretrainSettings, folder: Path, data: PairCache | RecordedPairs
    ) -> None:
        self.settings = settings
        self.folder = folder
        self.data = data
        self._check_recipe()
        self.accelerator = Accelerator(mixed_precision=settings.mixed_precision)
        resumes = (folder / STATE).exists()
        if resumes:
            settings = replace(settings, init="")  # no longer needed, and may be gone
        model = starting_model(settings)
        optimizer = torch.optim.AdamW(
            model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.model, self.optimizer = self.accelerator.prepare(model, optimizer)
        self.step = 0
        if resumes:
            self.step, weights, moments = load_state(folder)
            self._bare().load_state_dict(weights)
            self.optimizer.load_state_dict(moments)

    def run(self, until: int | None = None) -> Tokenizer:
        """Train up to ``until`` (or to the end) and return the tokenizer so far."""
        last = self.settings.steps
        if until is not None:
            last = min(until, last)
        start = time.monotonic()
        is_main = self.accelerator.is_main_process
        bar = tqdm(total=last, initial=self.step, desc="pretraining", disable=not is_main)
        strips_every = self.settings.strips_every
        while self.step < last:
            report = self.train_step()
            bar.update()
            bar.set_postfix(
                loss=report["loss"],
                equilibrium=report["equilibrium"],
                latent_std=report["latent_std"],
            )
            self._log(report | {"seconds": time.monotonic() - start})
            if self.step % self.settings.save_every == 0 or self.step == last:
                self.save()
            if is_main and strips_every and self.step % strips_every == 0:
                # the same pairs each time, to see whether the decoder learns
                pairs = self.data.draw(np.random.default_rng([self.settings.seed, 2**31]), 4, 2)
                picture = self.folder / "strips" / f"step_{self.step:06d}.png"
                draw_strips(self.tokenizer().model, pairs, picture)
        return self.tokenizer()

    def train_step(self) -> dict[str, float]:
        """Take one optimiser step; return the loss, its parts and the latent's spread."""
        process = self.accelerator.process_index
        rng = np.random.default_rng([self.settings.seed, self.step, process])
        torch.manual_seed(int(rng.integers(2**62)))  # the latent's noise
        start = time.monotonic()
        pairs = self.data.draw(rng, self.settings.units_per_batch, self.settings.pairs_per_unit)
        pairs = pairs.to(self.accelerator.device)
        loaded = time.monotonic()
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate(self.step, self.settings)
        with self.accelerator.autocast():
            loss, parts, spread = pair_loss(self._bare(), pairs, self.settings.loss, self.step)
        self.optimizer.zero_grad()
        self.accelerator.backward(loss)
        # the encoder is called in parts, which a wrapped forward() doesn't see
        if self.accelerator.num_processes > 1:
            for parameter in self.model.parameters():
                if parameter.grad is not None:
                    parameter.grad.copy_(self.accelerator.reduce(parameter.grad, "mean"))
        self.accelerator.clip_grad_norm_(self.model.parameters(), self.settings.clip_norm)
        self.optimizer.step()
        self.step += 1
        report = {"step": self.step, "loss": loss.item(), "latent_std": spread.item()}
        for name, part in parts.items():
            report[name] = part.item()
        # share of the step spent waiting for data
        report["data_share"] = (loaded - start) / max(time.monotonic() - start, 1e-9)
        return report

    def tokenizer(self) -> Tokenizer:
        """Return a frozen copy of the model, on the CPU."""
        copy = ForceAutoencoder(self.settings.model)
        copy.load_state_dict(self._bare().state_dict())
        return Tokenizer(copy)

    def save(self) -> None:
        """Write the training state and a loadable tokenizer, each atomically."""
        if not self.accelerator.is_main_process:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        write_json(self.folder / RECIPE, asdict(self.settings))
        save_state(self.folder, self.step, self._bare().state_dict(), self.optimizer.state_dict())
        self.tokenizer().save(self.folder / "tokenizer")

    def _check_recipe(self) -> None:
        """Raise DatasetError where the folder holds a run with other settings."""
        path = self.folder / RECIPE
        if not path.exists():
            return
        asked = asdict(self.settings)
        stored = with_defaults(asdict(PretrainSettings()), read_object(path, DatasetError))
        differs = sorted(k for k in asked if k not in MAY_CHANGE and stored[k] != asked[k])
        if differs:
            do = "Choose another out=."
            raise DatasetError(
                expected(str(path), "the recipe now asked for", f"another {differs}", do)
            )

    def _bare(self) -> ForceAutoencoder:
        return self.accelerator.unwrap_model(self.model)

    def _log(self, report: dict[str, float]) -> None:
        if not self.accelerator.is_main_process:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / "log.csv"
        is_new = not path.exists()
        with path.open("a", newline="") as handle:
            writer = csv.DictWriter(handle, fieldnames=list(report))
            if is_new:
                writer.writeheader()
            writer.writerow({name: f"{value:.6g}" for name, value in report.items()})


def pair_loss(
    model: ForceAutoencoder, pairs: Pairs, config: LossConfig, step: int
) -> tuple[torch.Tensor, dict[str, torch.Tensor], torch.Tensor]:
    """Return the loss, its parts and the latent's spread, for U units of n contacts each."""
    units = len(pairs.left_reference)
    per_unit = len(pairs.left_current) // units
    reference = torch.cat([pairs.left_reference, pairs.right_reference])  # (2U, 1, S, S)
    current = torch.cat([pairs.left_current, pairs.right_current])  # (2U·n, 1, S, S)
    encoded = model.encoder.encode_reference(reference).repeat(per_unit)  # each reference once
    posterior = model.encoder.encode_current(encoded, current)
    left_reference = pairs.left_reference.repeat_interleave(per_unit, dim=0)  # (U·n, 1, S, S)
    right_reference = pairs.right_reference.repeat_interleave(per_unit, dim=0)
    left_mean, right_mean = posterior.mean.chunk(2)  # (U·n, P, L) each
    left_log_variance, right_log_variance = posterior.log_variance.chunk(2)
    left = Side(left_reference, pairs.left_current, Posterior(left_mean, left_log_variance))
    right = Side(right_reference, pairs.right_current, Posterior(right_mean, right_log_variance))
    loss, parts = objective(model.decoder, left, right, config, step, per_unit)
    return loss, parts, posterior.mean.std(dim=0).mean()


@torch.no_grad()
def draw_strips(model: ForceAutoencoder, pairs: Pairs, path: Path) -> None:
    """Write a PNG of reconstructions, a row per pair.

    Left reference, left current, redrawn from z_L and from z_R; then the same of the right finger.
    """
    per_unit = len(pairs.left_current) // len(pairs.left_reference)
    left = pairs.left_reference.repeat_interleave(per_unit, dim=0)
    right = pairs.right_reference.repeat_interleave(per_unit, dim=0)
    z_left = model(left, pairs.left_current).mean
    z_right = model(right, pairs.right_current).mean
    columns = [
        left,
        pairs.left_current,
        model.decoder(left, z_left),
        model.decoder(left, z_right),
        right,
        pairs.right_current,
        model.decoder(right, z_right),
        model.decoder(right, z_left),
    ]
    rows = torch.cat(columns, dim=3)[:, 0]  # (B, S, 8·S)
    picture = (rows.clamp(0, 1) * 255).round().numpy().astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), picture.reshape(-1, picture.shape[-1]))
