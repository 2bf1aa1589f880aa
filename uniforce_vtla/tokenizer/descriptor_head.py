"""Newtons for scores, read by hand.

A sensor's own head over hand descriptors, without the tokenizer.

A policy may act on the tokenizer's latents. A score must not read forces through the same latents,
or both err alike and it does not show. A descriptor head knows one sensor and one kind of scene,
which is all a score needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer.descriptor import DESCRIPTOR_NAMES, NATURAL_UNITS
from uniforce_vtla.tokenizer.force_head import (
    ForceRegressor,
    HeadConfig,
    HeadTrainingConfig,
    train_head,
)
from uniforce_vtla.tokenizer.weights import load_model, read_config, save_checkpoint

SHIPPED = Path(__file__).parent / "assets"
SCENE = "wiping"


class DescriptorHead:
    """Reads one sensor's descriptors in one kind of scene.

    ``sensor`` is the name of the one it was fitted on.
    """

    def __init__(self, model: ForceRegressor, sensor: str) -> None:
        self._model = model.eval().requires_grad_(False)
        self.sensor = sensor

    @classmethod
    def fit(
        cls,
        sensor: str,
        episodes: Sequence[tuple[np.ndarray, np.ndarray]],
        stretch: int,
        steps: int,
        seed: int = 0,
    ) -> DescriptorHead:
        """Return a head fitted to stretches of (n, 6) descriptors and (n, 3) N per episode."""
        # (m, stretch, 1, 6)
        z = torch.cat([_stretches(_natural(seen), stretch) for seen, _ in episodes])
        force = torch.cat(
            [_stretches(torch.from_numpy(force_N), stretch) for _, force_N in episodes]
        )
        # it reads the sensor it learnt from, so fine print is welcome: little noise, small spreads
        # kept
        head = HeadConfig(channels=len(DESCRIPTOR_NAMES), grid=1)
        config = HeadTrainingConfig(head=head, steps=steps, input_noise=0.1, smallest_spread=0.05)
        return cls(train_head(z, force.numpy(), config, seed), sensor)

    @classmethod
    def from_pretrained(cls, sensor: str, folder: str | Path | None = None) -> DescriptorHead:
        """Load a sensor's head from a folder of heads; the shipped ones know the wiping scene.

        Raises CheckpointError: no head for that sensor, or one that doesn't fit.
        """
        place = Path(folder or SHIPPED / f"descriptor_heads_{SCENE}") / sensor
        facts = read_config(place)
        found = (facts.get("sensor"), facts.get("descriptor"))
        wanted = (sensor, list(DESCRIPTOR_NAMES))
        if found != wanted or not isinstance(facts.get("head"), dict):
            raise CheckpointError(expected(f"head in {place}", wanted, found, "Make it again."))
        try:
            config = HeadConfig(**facts["head"])
        except (TypeError, ContractError) as error:
            raise CheckpointError(
                expected(f"head in {place}", "a head's sizes", error, "Make it again.")
            ) from error
        return cls(load_model(place, lambda: ForceRegressor(config)), sensor)

    def save(self, folder: str | Path) -> Path:
        """Write the head into a folder of heads, one folder per sensor."""
        head = asdict(self._model.config)
        facts = {"sensor": self.sensor, "descriptor": list(DESCRIPTOR_NAMES), "head": head}
        return save_checkpoint(Path(folder) / self.sensor, self._model, facts)

    @torch.no_grad()
    def read(self, descriptors: np.ndarray) -> np.ndarray:
        """Return (n, 3) N, canonical frame, of an episode's (n, 6) descriptors.

        Raises ContractError: another shape, or numbers that aren't finite.
        """
        if descriptors.ndim != 2 or descriptors.shape[1] != len(DESCRIPTOR_NAMES):
            do = "Take them from descriptor.descriptors."
            raise ContractError(
                expected("descriptors", f"(n, {len(DESCRIPTOR_NAMES)})", descriptors.shape, do)
            )
        if not np.isfinite(descriptors).all():
            raise ContractError(
                expected(
                    "descriptors", "finite numbers", "NaN or inf", "Check the sensor's images."
                )
            )
        return self._model(_natural(descriptors)[None])[0].double().numpy()


def _natural(descriptors: np.ndarray) -> torch.Tensor:
    """Return (n, 1, 6): a map of one region in natural units."""
    return torch.from_numpy((descriptors / np.asarray(NATURAL_UNITS)).astype(np.float32))[:, None]


def _stretches(values: torch.Tensor, length: int) -> torch.Tensor:
    """Return (m, length, …) overlapping stretches of (n, …)."""
    return values.unfold(0, length, length // 2).movedim(-1, 1)
