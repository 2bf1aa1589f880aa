"""``Tokenizer``: a marker pair in, a latent force map out."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import torch

from uniforce_vtla.contracts import Finger, MarkerPair, check_count, check_finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.markers.reference import ReferenceMemory
from uniforce_vtla.markers.taxel_render import TaxelScales
from uniforce_vtla.tokenizer.entry import prepare
from uniforce_vtla.tokenizer.latent import POOL, Latent, own_latent, pool_latent
from uniforce_vtla.tokenizer.model import ForceAutoencoder, ReferenceCache, build_model
from uniforce_vtla.tokenizer.settings import TokenizerConfig
from uniforce_vtla.tokenizer.weights import (
    SIZES,
    checkpoint_folder,
    content_hash,
    load_model,
    read_config,
    save_checkpoint,
)

# of the canonicalizer's facts in a checkpoint; its spelling is part of every hash
STORED_KEY = "canonicaliser"
# two fingers, a few swaps; each costs about 0.5 MB
CACHED_REFERENCES = 8
MOST_REMEMBERED = 32  # environments that share a step; of larger batches no reference is remembered


type Images = np.ndarray | torch.Tensor


def canonicalizer_facts() -> dict[str, Any]:
    """Return what of the canonicalizer a checkpoint depends on; part of its hash."""
    return {"taxel_scales": TaxelScales().as_dict()}


class Tokenizer:
    """The frozen encoder with its entry, its memory of references and its identity.

    Attributes:
        model: network in eval mode; latents are made on its device.
        config: sizes of the network.
        canonicalizer: facts of the canonicalizer it was trained behind.
        hash: sha256 over weights, config and canonicalizer facts; checkpoints that use latents
            store it.

    Args:
        model: network.
        canonicalizer: facts; None for the running version's.
        known_hash: hash of weights that are loaded later; empty to compute it.
    """

    def __init__(
        self,
        model: ForceAutoencoder,
        canonicalizer: dict[str, Any] | None = None,
        known_hash: str = "",
    ) -> None:
        self.model = model.eval().requires_grad_(False)
        self.config: TokenizerConfig = model.config
        self.canonicalizer = canonicalizer_facts() if canonicalizer is None else canonicalizer
        self.hash = known_hash or content_hash(model, self.facts())
        self._references: ReferenceMemory[ReferenceCache] = ReferenceMemory(CACHED_REFERENCES)

    @classmethod
    def random(cls, config: TokenizerConfig | None = None, seed: int = 0) -> Tokenizer:
        """Return an untrained tokenizer: a baseline, and a stand-in for tests."""
        return cls(
            build_model(config or TokenizerConfig(), check_count("seed", seed, 2**63 - 1, least=0))
        )

    @classmethod
    def from_pretrained(cls, path: str | Path | None = None) -> Tokenizer:
        """Load a checkpoint folder, or one shipped with the package.

        ``"small"`` (None) or ``"nano"``.

        Raises CheckpointError: missing, truncated, of another shape, or made behind another
        canonicalizer.
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

    def encode(
        self,
        reference: MarkerPair | Images,
        current: Images | None = None,
        finger: Finger = "left",
    ) -> Latent:
        """Return latents (B, P, latent) float32: the posterior's mean, with this tokenizer's hash.

        Args:
            reference: a MarkerPair (then nothing else is given), or (B or 1, H, W) free-air images.
            current: (B, H, W) images in contact, as the sensor saw them, of any size.
            finger: finger that wore the sensor; the right finger's images are mirrored.

        Raises ContractError: images of the wrong form or of two sizes, an unknown finger, a
        reference without markers.
        """
        if isinstance(reference, MarkerPair) == (current is not None):
            wanted = "a MarkerPair alone, or reference and current"
            came = f"current {type(current).__name__}"
            raise ContractError(expected("encode", wanted, came, "Pass the pair, or both images."))
        if isinstance(reference, MarkerPair):
            finger = reference.finger
            current = reference.current[None]
            reference = reference.reference
        return Latent.of(self.latents(reference, current, check_finger(finger)), self.hash)

    @torch.no_grad()
    def latents(self, reference: Images, current: Images, finger: Finger) -> torch.Tensor:
        """Return latents (B, P, latent) as a plain tensor; arguments and errors as ``encode``."""
        # autocast would round what is remembered, and every later latent
        with torch.autocast(self._device.type, enabled=False):
            after = self._prepared(current, finger, "current")
            before = self._reference(reference, finger, len(after))
            do = "Use one camera setting for both."
            _same("current", reference.shape[-2:], current.shape[-2:], do)
            return self.model.encoder.encode_current(before, after).mean

    def pooled(
        self, reference: Images, current: Images, finger: Finger, grid: int = POOL
    ) -> Latent:
        """Return latents (B, grid², latent) as heads, calibrations and policies read them.

        See ``encode``.
        """
        return Latent.of(pool_latent(self.latents(reference, current, finger), grid), self.hash)

    def unmoved(self) -> torch.Tensor:
        """Return the pooled latent (P, latent) of a marker that stays where it is.

        A sensor in free air has about this one, whatever its pattern: .02 apart at most.
        """
        image = np.zeros((1, self.config.side, self.config.side), np.uint8)
        image[0, self.config.side // 2, self.config.side // 2] = 255
        return self.pooled(image, image, "right")[0]

    def forget_references(self) -> None:
        """Forget all references: another episode begins, or the network has moved."""
        self._references.forget()

    @torch.no_grad()
    def decode(
        self, reference: np.ndarray, z: torch.Tensor, finger: Finger = "left"
    ) -> torch.Tensor:
        """Return the (B, side, side) canonical image of latents z on the reference's sensor.

        Raises ContractError: a reference of the wrong form or count, or latents of another shape or
        without an origin; CheckpointError: latents of another tokenizer.
        """
        z = own_latent(z, self.hash, "decode")
        wanted = (self.num_patches, self.config.latent)
        _same("latents (…, P, L)", wanted, tuple(z.shape[1:]), "Decode what encode returned.")
        before = self._free_air(reference, check_finger(finger))
        if len(before) > 1:
            _same("references", len(z), len(before), "Pass one reference per latent, or one.")
        return self.model.decoder(before.expand(len(z), -1, -1, -1), z)[:, 0].clamp(0, 1)

    def _reference(self, reference: Images, finger: Finger, batch: int) -> ReferenceCache:
        """Return the encoded reference; it lasts an episode and is remembered."""
        if not isinstance(reference, np.ndarray | torch.Tensor):
            came = type(reference).__name__
            do = "Use Canonicalizer.pair."
            raise ContractError(expected("reference", "a MarkerPair or array", came, do))
        images = reference[None] if reference.ndim == 2 else reference
        if len(images) > 1:
            _same("references", batch, len(images), "Pass one reference per image, or one.")

        def encoded() -> ReferenceCache:
            return self.model.encoder.encode_reference(self._free_air(images, finger))

        if len(images) > MOST_REMEMBERED:
            return encoded()
        return self._references.get((finger, self._device), images, encoded)

    def _free_air(self, reference: Images, finger: Finger) -> torch.Tensor:
        images = reference[None] if reference.ndim == 2 else reference
        before = self._prepared(images, finger, "reference")
        if _one_grey(images):
            do = "Capture it again in free air."
            wanted = "an image with markers"
            raise ContractError(expected("reference", wanted, "all black or one grey", do))
        return before

    def _prepared(self, images: Images, finger: Finger, name: str) -> torch.Tensor:
        return prepare(images, finger, self.config.side, name).to(self._device)

    @property
    def _device(self) -> torch.device:
        return next(self.model.parameters()).device


@functools.cache
def shipped_sizes() -> dict[str, str]:
    """Return content hash → size of the tokenizers that come with the package."""
    return {Tokenizer.from_pretrained(size).hash: size for size in SIZES}


def _one_grey(images: Images) -> bool:
    """Return whether one of (B, H, W) images shows a single grey level."""
    flat = torch.as_tensor(images).flatten(1)
    return bool((flat.amax(dim=1) == flat.amin(dim=1)).any())


def _same(what: str, wanted: object, came: object, do: str) -> None:
    if wanted != came:
        raise ContractError(expected(what, wanted, came, do))


def _sizes(facts: dict[str, Any], folder: Path) -> TokenizerConfig:
    try:
        return TokenizerConfig(**facts["model"])
    except (KeyError, TypeError, ContractError) as error:
        wanted = "the fields of TokenizerConfig"
        raise CheckpointError(
            expected(f"config of {folder}", wanted, error, "Is this a tokenizer?")
        ) from error


def _same_canonicalizer(facts: dict[str, Any], folder: Path) -> dict[str, Any]:
    stored = facts.get(STORED_KEY)
    running = canonicalizer_facts()
    if stored != running:
        do = "Use its version, or pretrain again."
        raise CheckpointError(expected(f"canonicalizer of {folder}", stored, running, do))
    return running
