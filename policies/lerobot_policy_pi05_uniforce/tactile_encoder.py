"""The frozen tactile tokenizer inside a policy: marker images → pooled latents, references encoded once."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.weights import no_weights
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig, pool_latent
from uniforce_vtla.tokenizer.api import canonicaliser_facts
from uniforce_vtla.tokenizer.entry import prepare_tensor
from uniforce_vtla.tokenizer.model import ForceAutoencoder, ReferenceCache, build_model
from uniforce_vtla.tokenizer.weights import content_hash

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig


class TactileEncoder(nn.Module):
    """A frozen tokenizer: no gradients, always in eval mode, saved with the policy so that it stands alone.

    Args:
        model: the tokenizer's network; its decoder is kept too, so that its hash can be checked.
        grid: latents are pooled to grid × grid.
    """

    def __init__(self, model: ForceAutoencoder, grid: int) -> None:
        super().__init__()
        self.model = model
        self.grid = grid
        self._references: dict[str, tuple[Tensor, ReferenceCache]] = {}
        self.requires_grad_(False)
        self.train(False)

    def train(self, mode: bool = True) -> TactileEncoder:
        """Stay in eval mode: LeRobot calls ``policy.train()`` at every step."""
        return super().train(False)

    def forget_references(self) -> None:
        """Drop cached references; call it where an episode begins."""
        self._references.clear()

    @torch.no_grad()
    def feel(self, slot: str, finger: Finger, reference: Tensor, current: Tensor) -> Tensor:
        """Encode one slot's pair.

        Args:
            slot: touch slot, the key of the reference cache.
            finger: which finger wears the sensor; decides the mirror.
            reference: (B, 3, H, W) or (B, H, W) in [0, 1], free air.
            current: same shape.

        Returns:
            (B, K, latent) pooled latents.
        """
        cached = self._encode_reference(slot, finger, reference)
        latent = self.model.encoder.encode_current(cached, self._prepare(current, finger, "current")).mean
        return pool_latent(latent, self.grid)  # (B, K, latent)

    def _encode_reference(self, slot: str, finger: Finger, reference: Tensor) -> ReferenceCache:
        key = f"{slot}/{finger}"
        known = self._references.get(key)
        if known is not None and torch.equal(known[0], reference):
            return known[1]
        before = self._prepare(reference, finger, "reference")
        if not bool((before.amax(dim=(1, 2, 3)) > 0).all()):
            do = "Capture it again in free air."
            raise ContractError(expected(f"reference of {slot}", "an image with markers", "all black", do))
        cache = self.model.encoder.encode_reference(before)
        self._references[key] = (reference.clone(), cache)
        return cache

    def _prepare(self, images: Tensor, finger: Finger, name: str) -> Tensor:
        grey = images[:, 0] if images.ndim == 4 else images  # RGB copies of one binary channel
        return prepare_tensor(grey, right=finger == "right", side=self.model.config.side, name=name)


def build_encoder(config: PI05UniforceConfig, empty: bool = False) -> TactileEncoder:
    """Make the encoder a config asks for and write the tokenizer's facts into that config.

    A config loaded from a checkpoint already knows its tokenizer: it is rebuilt and its weights come from the
    checkpoint, which gives it memory where ``empty``. A new policy takes the tokenizer at ``tokenizer_path`` (None:
    the shipped one).
    """
    if config.tokenizer_config is not None:
        return TactileEncoder(_rebuild(config.tokenizer_config, empty), config.latent_grid)
    tokenizer = Tokenizer.from_pretrained(config.tokenizer_path)
    config.tokenizer_config = tokenizer.facts()
    config.tokenizer_hash = tokenizer.hash
    config.num_patches = tokenizer.num_patches
    config.latent_size = tokenizer.config.latent
    return TactileEncoder(tokenizer.model, config.latent_grid)


def check_hash(encoder: TactileEncoder, config: PI05UniforceConfig) -> None:
    """Raise CheckpointError unless the loaded tokenizer is, bit by bit, the one the policy was trained with."""
    found = content_hash(encoder.model, config.tokenizer_config or {})
    if found != config.tokenizer_hash:
        do = "The tokenizer inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("tokenizer hash", config.tokenizer_hash, found, do))


def _rebuild(facts: dict[str, Any], empty: bool) -> ForceAutoencoder:
    stored, running = facts.get("canonicaliser"), canonicaliser_facts()
    if stored != running:
        do = "Use the version it was trained with, or train again."
        raise CheckpointError(expected("canonicaliser of the checkpoint", stored, running, do))
    with no_weights() if empty else nullcontext():
        return build_model(TokenizerConfig(**facts["model"]), seed=0)
