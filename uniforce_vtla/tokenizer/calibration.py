"""A sensor's calibration.

A map of its latents, and how well both fingers agree.

It belongs to one unit. It is fitted by grasps (``calibrate.py``) or by known loads (``gains.py``),
and applied by ``ForceSensor``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from uniforce_vtla.contracts import Finger, check_count
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.calibration_choice import Choice, read_choice
from uniforce_vtla.tokenizer.latent import Latent, own_latent
from uniforce_vtla.tokenizer.latent_map import LatentMap
from uniforce_vtla.tokenizer.settings import OBJECT_CLASSES
from uniforce_vtla.tokenizer.weights import content_hash, load_model, read_config, save_checkpoint

MAX_NUMBERS = 4096  # of a pooled latent; larger maps are none of ours


@dataclass(frozen=True)
class Agreement:
    """Force read by the calibrated finger and by the anchor, on held-out grasps of a class."""

    grasps: int
    r2: tuple[float, float, float]  # x, y, z
    abs_r: tuple[float, float, float]
    r2_before: tuple[float, float, float]  # without the map


@dataclass(frozen=True)
class Calibration:
    """A fitted map, the networks it belongs to, and how well the fingers agree."""

    map: LatentMap
    tokenizer_hash: str  # whose latents it maps
    head_hash: str  # of the force head that judged it
    new: str
    anchor: str
    ridge: float  # chosen by cross-validation
    # turn that brings the new sensor's shear, as read before, to the anchor's; x towards y
    turn_deg: float
    agreement: dict[str, Agreement]  # by class of objects
    choice: Choice | None = None  # of grasps; None: of loads, or older than the choice

    @torch.no_grad()
    def __call__(self, z: Latent) -> Latent:
        """Return pooled latents (B, P, latent) as the anchor would have given them.

        Raises ContractError: latents of another form or without an origin; CheckpointError: latents
        of another tokenizer.
        """
        own = own_latent(z, self.tokenizer_hash, f"the calibration of {self.new}")
        wanted = len(self.map.centre)
        if own.ndim != 3 or len(own) == 0 or own[0].numel() != wanted:
            do = "Pool them as the calibration's were: pool_latent(z)."
            came = tuple(z.shape)
            raise ContractError(
                expected("latents to calibrate", f"(B, P, L) of {wanted}", came, do)
            )
        return Latent.of(self.map(own), self.tokenizer_hash)

    def check_fits(self, kind: str, finger: Finger) -> None:
        """Raise CheckpointError: made of another kind than the finger wears; "" isn't compared."""
        made_of = self.new.partition("+")[0].partition(":")[0]
        if kind and made_of in list_sensors() and made_of != kind:
            do = "Calibrate the sensor that the finger wears."
            came = f"one of {self.new}"
            raise CheckpointError(expected(f"{finger}_calibration", f"one of a {kind}", came, do))

    @property
    def hash(self) -> str:
        """Content hash of the map and its tokenizer; scores of a policy store it."""
        return content_hash(self.map, {"tokenizer_hash": self.tokenizer_hash})

    @property
    def latent_gain(self) -> float:
        """By what a weighed sensor's latents are scaled."""
        return 1 + float(self.map.weight[0, 0])

    def worst(self, classes: Sequence[str] = OBJECT_CLASSES) -> tuple[str, float]:
        """Return the class among ``classes`` whose R² of Fz is lowest, and that R²."""
        worst = min(classes, key=lambda name: self.agreement[name].r2[2])
        return worst, self.agreement[worst].r2[2]

    def facts(self) -> dict[str, object]:
        """Return which sensors it matches, and how well."""
        facts: dict[str, object] = {
            "new": self.new,
            "anchor": self.anchor,
            "ridge": self.ridge,
            "turn_deg": self.turn_deg,
        }
        if self.choice:
            facts["choice"] = asdict(self.choice)
        facts["agreement"] = {name: asdict(found) for name, found in self.agreement.items()}
        return facts

    def save(self, path: str | Path) -> Path:
        """Write the map and its facts to a folder that ``load`` reads."""
        belongs_to = {
            "patches": self.map.patches,
            "latent": self.map.latent,
            "tokenizer_hash": self.tokenizer_hash,
            "head_hash": self.head_hash,
        }
        return save_checkpoint(Path(path), self.map, self.facts() | belongs_to)

    @classmethod
    def load(cls, path: str | Path, tokenizer_hash: str) -> Calibration:
        """Load a calibration made for the tokenizer with this hash.

        Raises CheckpointError: damaged, made for another tokenizer, or a gain of version 0.1.
        """
        folder = Path(path)
        facts = read_config(folder)
        came = facts.get("tokenizer_hash")
        if came != tokenizer_hash:
            do = "Calibrate again with this tokenizer."
            raise CheckpointError(expected(f"tokenizer of {folder}", tokenizer_hash, came, do))
        try:
            patches, latent = _sizes(facts)
            stored = _stored(facts)
        except (KeyError, TypeError, ValueError, AttributeError, ContractError) as error:
            wanted = "the facts of a calibration"
            raise CheckpointError(
                expected(f"config of {folder}", wanted, error, "Calibrate again.")
            ) from error
        latent_map = load_model(folder, lambda: LatentMap(patches, latent))
        return cls(latent_map.eval(), tokenizer_hash, **stored)


def _sizes(facts: dict[str, Any]) -> tuple[int, int]:
    patches = check_count("patches", facts["patches"], MAX_NUMBERS)
    latent = check_count("latent", facts["latent"], MAX_NUMBERS)
    check_count("numbers", patches * latent, MAX_NUMBERS)
    return patches, latent


def _stored(facts: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a calibration that its config holds.

    Raises as a damaged one makes it.
    """
    if facts.get("gain", 1.0) != 1:
        raise ValueError("a gain of newtons, of version 0.1")
    choice = None
    if "choice" in facts:
        choice = read_choice(facts["choice"])
    return {
        "head_hash": str(facts["head_hash"]),
        "new": str(facts["new"]),
        "anchor": str(facts["anchor"]),
        "ridge": float(facts["ridge"]),
        "turn_deg": float(facts["turn_deg"]),
        "agreement": {name: _agreement(stored) for name, stored in facts["agreement"].items()},
        "choice": choice,
    }


def _agreement(stored: dict[str, Any]) -> Agreement:
    return Agreement(
        grasps=int(stored["grasps"]),
        r2=_three(stored["r2"]),
        abs_r=_three(stored["abs_r"]),
        r2_before=_three(stored["r2_before"]),
    )


def _three(stored: Sequence[Any]) -> tuple[float, float, float]:
    x, y, z = stored
    return float(x), float(y), float(z)
