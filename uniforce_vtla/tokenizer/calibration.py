"""Label-free calibration: a sensor never pretrained on learns the known one's latent on the same grasps.

Both fingers grasp an externally held object for about a minute.  Their forces are equal, so their latents should be:
a small adapter on the new sensor's latent is fitted until they are.  No force is ever measured.  It corrects what a
reference image can't show: stiffness and gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from uniforce_vtla.contracts import check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.latent import Latent, as_map, own_latent
from uniforce_vtla.tokenizer.settings import CalibrationConfig
from uniforce_vtla.tokenizer.weights import load_model, read_config, save_checkpoint

MAX_SIZE = 16384  # of an adapter's latent and hidden units, see model.LIMITS


class LatentAdapter(nn.Module):
    """z' = z + affine(z) + bend(z, mean of z over the pad); starts as the identity.

    The same for every patch: stiffness and gain belong to the sensor, not to a place on it.
    """

    spread: torch.Tensor

    def __init__(self, latent: int, hidden: int) -> None:
        super().__init__()
        self.register_buffer("spread", torch.ones(latent))
        self.affine = nn.Linear(latent, latent)
        self.bend = nn.Sequential(nn.Linear(2 * latent, hidden), nn.Tanh(), nn.Linear(hidden, latent))
        for layer in (self.affine, self.bend[2]):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """Return adapted latents (B, P, latent)."""
        unit = z / self.spread
        around = unit.mean(dim=1, keepdim=True).expand_as(unit)
        return z + self.spread * (self.affine(unit) + self.bend(torch.cat([unit, around], dim=-1)))


@dataclass(frozen=True)
class Calibration:
    """A fitted adapter and how well the fingers agree on held-out grasps, before and after."""

    adapter: LatentAdapter  # the network, in eval mode
    tokenizer_hash: str  # the tokenizer whose latents it adapts
    new: str
    anchor: str
    # ‖z_new − z_anchor‖² over ‖z_anchor − mean‖², held-out grasps, total latent of the pad
    imbalance_before: float
    imbalance_after: float  # the same with the adapter

    @torch.no_grad()
    def __call__(self, z: Latent) -> Latent:
        """Return the latents (B, P, latent) the anchor would have given; raises as ``ForceHead`` does."""
        own = own_latent(z, self.tokenizer_hash, f"the calibration of {self.new}")
        return Latent.of(self.adapter(own), self.tokenizer_hash)

    def facts(self) -> dict[str, object]:
        """Return which sensors it matches, and how well."""
        names = ("new", "anchor", "imbalance_before", "imbalance_after")
        return {name: getattr(self, name) for name in names}

    def save(self, path: str | Path) -> Path:
        """Write the adapter and its facts to a folder ``load`` reads."""
        sizes = {"latent": self.adapter.affine.in_features, "hidden": self.adapter.bend[0].out_features}
        facts = self.facts() | sizes | {"tokenizer_hash": self.tokenizer_hash}
        return save_checkpoint(Path(path), self.adapter, facts)

    @classmethod
    def load(cls, path: str | Path, tokenizer_hash: str) -> Calibration:
        """Load a calibration made for the tokenizer with this hash.

        Raises:
            CheckpointError: damaged, or made for another tokenizer.
        """
        folder = Path(path)
        facts = read_config(folder)
        if (came := facts.get("tokenizer_hash")) != tokenizer_hash:
            do = "Calibrate again with this tokenizer."
            raise CheckpointError(expected(f"tokenizer of {folder}", tokenizer_hash, came, do))
        try:
            latent, hidden = (check_count(name, facts[name], MAX_SIZE) for name in ("latent", "hidden"))
            names = str(facts["new"]), str(facts["anchor"])
            judged = float(facts["imbalance_before"]), float(facts["imbalance_after"])
        except (KeyError, TypeError, ValueError, ContractError) as error:
            wanted, do = "the facts of a calibration", "Calibrate again."
            raise CheckpointError(expected(f"config of {folder}", wanted, error, do)) from error
        adapter = load_model(folder, lambda: LatentAdapter(latent, hidden))
        return cls(adapter.eval(), tokenizer_hash, *names, *judged)


def calibrate(
    z_new: torch.Tensor,
    z_anchor: torch.Tensor,
    tokenizer_hash: str,
    new: str,
    anchor: str,
    config: CalibrationConfig | None = None,
) -> Calibration:
    """Fit an adapter to paired latents of the same grasps.

    Args:
        z_new: (n, P, latent) of the sensor to calibrate, canonical frame.
        z_anchor: (n, P, latent) of the known sensor on the other finger.
        tokenizer_hash: of the tokenizer both came from.
        new: name of the sensor to calibrate.
        anchor: name of the known one.
        config: sizes and steps.

    Raises:
        ContractError: too few grasps, different shapes, NaN, no origin, or grasps that never load the sensors.
        CheckpointError: latents of another tokenizer.
    """
    config = config or CalibrationConfig()
    z_new, z_anchor = (own_latent(z, tokenizer_hash, "calibration") for z in (z_new, z_anchor))
    _check(z_new, z_anchor, config)
    order = np.random.default_rng(config.seed).permutation(len(z_new))
    judge, fit = np.split(order, [max(1, int(config.held_out * len(order)))])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        adapter = _fit(z_new[fit], z_anchor[fit], config)
    with torch.no_grad():
        before = imbalance(z_new[judge], z_anchor[judge])
        after = imbalance(adapter(z_new[judge]), z_anchor[judge])
    return Calibration(adapter, tokenizer_hash, new, anchor, before, after)


def imbalance(z_new: torch.Tensor, z_anchor: torch.Tensor) -> float:
    """Return the disagreement of the pads' total latents over the anchor's own variance; 0 is equilibrium."""
    new, anchor = z_new.mean(dim=1), z_anchor.mean(dim=1)  # (n, latent)
    spread = (anchor - anchor.mean(dim=0)).square().sum()
    return float((new - anchor).square().sum() / spread.clamp_min(1e-12))


def _fit(z_new: torch.Tensor, z_anchor: torch.Tensor, config: CalibrationConfig) -> LatentAdapter:
    adapter = LatentAdapter(z_new.shape[-1], config.hidden)
    adapter.spread.copy_(z_anchor.flatten(0, 1).std(dim=0).clamp_min(1e-6))
    rates = {"lr": config.learning_rate, "weight_decay": config.identity_pull}
    optimizer = torch.optim.AdamW(adapter.parameters(), **rates)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.steps)
    for _ in range(config.steps):
        rows = torch.randint(len(z_new), (config.batch,))
        gap = (adapter(z_new[rows]) - z_anchor[rows]) / adapter.spread
        regions = as_map(gap).unfold(2, 2, 2).unfold(3, 2, 2).mean(dim=(-1, -2))  # 2×2 patches at a time
        # fingers balance in total, maps only loosely
        loss = 10 * gap.mean(dim=1).square().mean() + regions.square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return adapter.eval()


def _check(z_new: torch.Tensor, z_anchor: torch.Tensor, config: CalibrationConfig) -> None:
    if z_new.shape != z_anchor.shape or z_new.ndim != 3:
        came = f"{tuple(z_new.shape)} and {tuple(z_anchor.shape)}"
        raise ContractError(expected("paired latents", "(n, P, latent) twice", came, "Pair them by frame."))
    if len(z_new) < config.min_pairs:
        do = "Grasp for a minute, with every force from light to strong."
        raise ContractError(expected("grasps", f"at least {config.min_pairs}", len(z_new), do))
    if not bool(z_new.isfinite().all() and z_anchor.isfinite().all()):
        raise ContractError(expected("latents", "finite numbers", "NaN or inf", "Check the recordings."))
    if float(z_anchor.mean(dim=1).std(dim=0).max()) < 1e-6:
        do = "Hold the object from outside and squeeze, push and twist it."
        raise ContractError(expected("grasps", "changing forces", "the same latent throughout", do))
