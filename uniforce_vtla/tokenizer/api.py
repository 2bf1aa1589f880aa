"""``Tokenizer``: a marker pair in, a latent force map out."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, overload

import numpy as np
import torch

from uniforce_vtla.contracts import Finger, MarkerPair, check_count, check_finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.markers.taxel_render import TaxelScales
from uniforce_vtla.tokenizer.entry import prepare
from uniforce_vtla.tokenizer.latent import Latent, own_latent
from uniforce_vtla.tokenizer.model import ForceAutoencoder, ReferenceCache, TokenizerConfig, build_model
from uniforce_vtla.tokenizer.weights import (
    checkpoint_folder,
    content_hash,
    load_model,
    read_config,
    save_checkpoint,
)

CACHED_REFERENCES = 8  # two slots, a few swaps; each costs about 0.5 MB


def canonicaliser_facts() -> dict[str, Any]:
    """Return what of the canonicaliser a checkpoint depends on; part of its hash."""
    return {"taxel_scales": TaxelScales().as_dict()}


class Tokenizer:
    """The frozen encoder with its entry, its reference cache and its identity.

    Attributes:
        model: the network, in eval mode.
        config: its sizes.
        canonicaliser: facts of the canonicaliser it was trained behind.
        hash: sha256 over weights, config and canonicaliser facts; checkpoints that use z must store it.
    """

    def __init__(self, model: ForceAutoencoder, canonicaliser: dict[str, Any] | None = None) -> None:
        self.model = model.eval().requires_grad_(False)
        self.config: TokenizerConfig = model.config
        self.canonicaliser = canonicaliser_facts() if canonicaliser is None else canonicaliser
        self.hash = content_hash(model, self.facts())
        self._references: dict[str, ReferenceCache] = {}

    @classmethod
    def random(cls, config: TokenizerConfig | None = None, seed: int = 0) -> Tokenizer:
        """Return an untrained tokenizer: a baseline, and a stand-in for tests."""
        return cls(build_model(config or TokenizerConfig(), check_count("seed", seed, 2**63 - 1, least=0)))

    @classmethod
    def from_pretrained(cls, path: str | Path | None = None) -> Tokenizer:
        """Load a checkpoint folder, or one shipped with the package: ``"small"`` (None) or ``"nano"``.

        Raises:
            CheckpointError: missing, truncated, of another shape, or made behind another canonicaliser.
        """
        folder = checkpoint_folder(path, "tokenizer")
        facts = read_config(folder)
        sizes = _sizes(facts, folder)
        model = load_model(folder, lambda: build_model(sizes, seed=0))
        return cls(model, _same_canonicaliser(facts, folder))

    def save(self, path: str | Path) -> Path:
        """Write weights and facts to a folder that ``from_pretrained`` reads."""
        return save_checkpoint(Path(path), self.model, self.facts())

    def facts(self) -> dict[str, Any]:
        """Return everything but the weights that decides what z means."""
        return {"model": self.config.facts(), "canonicaliser": self.canonicaliser}

    @property
    def num_patches(self) -> int:
        """P, the number of latent vectors per image."""
        return self.config.num_patches

    @overload
    def encode(self, reference: MarkerPair) -> Latent: ...

    @overload
    def encode(self, reference: np.ndarray, current: np.ndarray, finger: Finger = "left") -> Latent: ...

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

        Raises:
            ContractError: images of the wrong form or of two sizes, an unknown finger, a reference without markers.
        """
        if isinstance(reference, MarkerPair):
            _not_given(current)
            return self.encode(reference.reference[None], reference.current[None], reference.finger)
        after = prepare(_given(current), check_finger(finger), self.config.side, "current")
        before = self._reference(reference, finger, len(after))
        _same("current", reference.shape[-2:], _given(current).shape[-2:], "Use one camera setting for both.")
        z = self.model.encoder.encode_current(before, after).mean
        return Latent.of(z, self.hash)

    @torch.no_grad()
    def decode(self, reference: np.ndarray, z: torch.Tensor, finger: Finger = "left") -> torch.Tensor:
        """Return the (B, side, side) canonical image that latents z would show on that reference's sensor.

        Raises:
            ContractError: a reference of the wrong form or count, or latents of another shape or without an origin.
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
        """Return the reference's cache; a single one is kept by content, since it lasts an episode."""
        images = reference[None] if getattr(reference, "ndim", 0) == 2 else reference
        before_count = len(images) if isinstance(images, np.ndarray) else 0
        if before_count > 1:
            _same("references", batch, before_count, "Pass one reference per image, or one.")
            return self.encode_reference(images, finger)
        key = _content_key(images, finger)
        if key not in self._references:
            self._references[key] = self.encode_reference(images, finger)
        if len(self._references) > CACHED_REFERENCES:
            self._references.pop(next(iter(self._references)))  # the oldest
        return self._references[key]

    def encode_reference(self, images: np.ndarray, finger: Finger) -> ReferenceCache:
        """Return what frames need of free-air images (B, H, W), not cached; ContractError if one shows no marker."""
        return self.model.encoder.encode_reference(self._free_air(images, finger))

    def _free_air(self, images: np.ndarray, finger: Finger) -> torch.Tensor:
        before = prepare(images, finger, self.config.side, "reference")
        flat = images.reshape(len(before), -1)
        if bool((flat.min(axis=1) == flat.max(axis=1)).any()):
            do = "Capture it again in free air."
            raise ContractError(expected("reference", "an image with markers", "all black or one grey", do))
        return before


def _given(current: np.ndarray | None) -> np.ndarray:
    if current is None:
        raise ContractError(
            expected("encode", "a MarkerPair or reference and current", "no current", "Pass both images.")
        )
    return current


def _not_given(current: np.ndarray | None) -> None:
    if current is not None:
        do = "Pass the pair, or reference and current."
        raise ContractError(expected("encode", "a MarkerPair alone", "a current beside it", do))


def _same(what: str, wanted: object, came: object, do: str) -> None:
    if wanted != came:
        raise ContractError(expected(what, wanted, came, do))


def _content_key(images: np.ndarray, finger: Finger) -> str:
    if not isinstance(images, np.ndarray):
        raise ContractError(
            expected("reference", "a MarkerPair or array", type(images).__name__, "Use Canonicalizer.pair.")
        )
    header = f"{finger} {images.dtype} {images.shape}".encode()
    return hashlib.blake2b(header + np.ascontiguousarray(images).tobytes(), digest_size=16).hexdigest()


def _sizes(facts: dict[str, Any], folder: Path) -> TokenizerConfig:
    try:
        return TokenizerConfig(**facts["model"])
    except (KeyError, TypeError, ContractError) as error:
        raise CheckpointError(
            expected(f"config of {folder}", "the fields of TokenizerConfig", error, "Is this a tokenizer?")
        ) from error


def _same_canonicaliser(facts: dict[str, Any], folder: Path) -> dict[str, Any]:
    stored, running = facts.get("canonicaliser"), canonicaliser_facts()
    if stored != running:
        raise CheckpointError(
            expected(f"canonicaliser of {folder}", stored, running, "Use its version, or pretrain again.")
        )
    return running
