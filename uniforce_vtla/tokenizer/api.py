"""``Tokenizer``: a marker pair in, a latent force map out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from uniforce_vtla.contracts import Finger, MarkerPair, check_count, check_finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.markers.reference import ReferenceMemory
from uniforce_vtla.markers.taxel_render import TaxelScales
from uniforce_vtla.tokenizer.entry import prepare
from uniforce_vtla.tokenizer.latent import Latent, own_latent
from uniforce_vtla.tokenizer.model import ForceAutoencoder, ReferenceCache, build_model
from uniforce_vtla.tokenizer.settings import TokenizerConfig
from uniforce_vtla.tokenizer.weights import (
    checkpoint_folder,
    content_hash,
    load_model,
    read_config,
    save_checkpoint,
)

# of the canonicalizer's facts in a checkpoint; its spelling is part of every hash
STORED_KEY = "canonicaliser"
CACHED_REFERENCES = 8  # two slots, a few swaps; each costs about 0.5 MB


def canonicalizer_facts() -> dict[str, Any]:
    """Return what of the canonicalizer a checkpoint depends on; part of its hash."""
    return {"taxel_scales": TaxelScales().as_dict()}


class Tokenizer:
    """The frozen encoder with its entry, its reference cache and its identity.

    Attributes:
        model: the network, in eval mode.
        config: its sizes.
        canonicalizer: facts of the canonicalizer it was trained behind.
        hash: sha256 over weights, config and canonicalizer facts; checkpoints that use z must store it.
    """

    def __init__(
        self, model: ForceAutoencoder, canonicalizer: dict[str, Any] | None = None
    ) -> None:
        self.model = model.eval().requires_grad_(False)
        self.config: TokenizerConfig = model.config
        self.canonicalizer = canonicalizer_facts() if canonicalizer is None else canonicalizer
        self.hash = content_hash(model, self.facts())
        self._references: ReferenceMemory[ReferenceCache] = ReferenceMemory(CACHED_REFERENCES)

    @classmethod
    def random(cls, config: TokenizerConfig | None = None, seed: int = 0) -> Tokenizer:
        """Return an untrained tokenizer: a baseline, and a stand-in for tests."""
        return cls(
            build_model(config or TokenizerConfig(), check_count("seed", seed, 2**63 - 1, least=0))
        )

    @classmethod
    def from_pretrained(cls, path: str | Path | None = None) -> Tokenizer:
        """Load a checkpoint folder, or one shipped with the package: ``"small"`` (None) or ``"nano"``.

        Raises CheckpointError: missing, truncated, of another shape, or made behind another canonicalizer.
        """
        folder = checkpoint_folder(path, "tokenizer")
        facts = read_config(folder)
        sizes = _sizes(facts, folder)
        model = load_model(folder, lambda: build_model(sizes, seed=0))
        return cls(model, _same_canonicalizer(facts, folder))

    def save(self, path: str | Path) -> Path:
        """Write weights and facts to a folder that ``from_pretrained`` reads."""
        return save_checkpoint(Path(path), self.model, self.facts())

    def facts(self) -> dict[str, Any]:
        """Return everything but the weights that decides what z means."""
        return {"model": self.config.facts(), STORED_KEY: self.canonicalizer}

    @property
    def num_patches(self) -> int:
        """P, the number of latent vectors per image."""
        return self.config.num_patches

    @torch.no_grad()
    def encode(
        self,
        reference: MarkerPair | np.ndarray,
        current: np.ndarray | None = None,
        finger: Finger = "left",
    ) -> Latent:
        """Return latents (B, P, latent) float32: the posterior's mean, a tensor that carries this tokenizer's hash.

        Args:
            reference: a MarkerPair (then nothing else is given), or (B or 1, H, W) free-air images.
            current: (B, H, W) images in contact, as the sensor saw them, of any size.
            finger: who wore the sensor; the right finger's images are mirrored.

        Raises ContractError: images of the wrong form or of two sizes, an unknown finger, a reference without markers.
        """
        if isinstance(reference, MarkerPair) == (current is not None):
            wanted, came = (
                "a MarkerPair alone, or reference and current",
                f"current {type(current).__name__}",
            )
            raise ContractError(expected("encode", wanted, came, "Pass the pair, or both images."))
        if isinstance(reference, MarkerPair):
            images, contact, finger = reference.reference, reference.current[None], reference.finger
        else:
            images, contact = reference, np.asarray(current)
        after = prepare(contact, check_finger(finger), self.config.side, "current")
        before = self._reference(images, finger, len(after))
        _same("current", images.shape[-2:], contact.shape[-2:], "Use one camera setting for both.")
        z = self.model.encoder.encode_current(before, after).mean
        return Latent.of(z, self.hash)

    @torch.no_grad()
    def decode(
        self, reference: np.ndarray, z: torch.Tensor, finger: Finger = "left"
    ) -> torch.Tensor:
        """Return the (B, side, side) canonical image that latents z would show on that reference's sensor.

        Raises ContractError: a reference of the wrong form or count, or latents of another shape or without an origin;
        CheckpointError: latents of another tokenizer.
        """
        z = own_latent(z, self.hash, "decode")
        wanted = (self.num_patches, self.config.latent)
        _same("latents (…, P, L)", wanted, tuple(z.shape[1:]), "Decode what encode returned.")
        before = self._free_air(reference, check_finger(finger))
        if len(before) > 1:
            _same("references", len(z), len(before), "Pass one reference per latent, or one.")
        return self.model.decoder(before.expand(len(z), -1, -1, -1), z)[:, 0].clamp(0, 1)

    def _reference(self, reference: np.ndarray, finger: Finger, batch: int) -> ReferenceCache:
        if not isinstance(reference, np.ndarray):
            came, do = type(reference).__name__, "Use Canonicalizer.pair."
            raise ContractError(expected("reference", "a MarkerPair or array", came, do))
        images = reference[None] if reference.ndim == 2 else reference
        if len(images) > 1:
            _same("references", batch, len(images), "Pass one reference per image, or one.")
        return self.encode_reference(images, finger)

    def encode_reference(self, images: np.ndarray, finger: Finger) -> ReferenceCache:
        """Return what frames need of free-air images (B, H, W); a single one is remembered: it lasts an episode.

        Raises ContractError: images of the wrong form, or without markers.
        """

        def encode() -> ReferenceCache:
            return self.model.encoder.encode_reference(self._free_air(images, finger))

        return encode() if len(images) > 1 else self._references.get(finger, images, encode)

    def _free_air(self, images: np.ndarray, finger: Finger) -> torch.Tensor:
        before = prepare(images, finger, self.config.side, "reference")
        flat = images.reshape(len(before), -1)
        if bool((flat.min(axis=1) == flat.max(axis=1)).any()):
            do = "Capture it again in free air."
            raise ContractError(
                expected("reference", "an image with markers", "all black or one grey", do)
            )
        return before


def _same(what: str, wanted: object, came: object, do: str) -> None:
    if wanted != came:
        raise ContractError(expected(what, wanted, came, do))


def _sizes(facts: dict[str, Any], folder: Path) -> TokenizerConfig:
    try:
        return TokenizerConfig(**facts["model"])
    except (KeyError, TypeError, ContractError) as error:
        wanted, do = "the fields of TokenizerConfig", "Is this a tokenizer?"
        raise CheckpointError(expected(f"config of {folder}", wanted, error, do)) from error


def _same_canonicalizer(facts: dict[str, Any], folder: Path) -> dict[str, Any]:
    stored, running = facts.get(STORED_KEY), canonicalizer_facts()
    if stored != running:
        do = "Use its version, or pretrain again."
        raise CheckpointError(expected(f"canonicalizer of {folder}", stored, running, do))
    return running
