"""The frozen tokenizer and force head inside a policy: built anew or from its checkpoint, compared by their hashes."""

from __future__ import annotations

import functools
from contextlib import nullcontext
from dataclasses import asdict
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.weights import no_weights
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.keys import SLOTS
from uniforce_vtla.markers.reference import ReferenceMemory
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig, pool_latent
from uniforce_vtla.tokenizer.api import STORED_KEY, canonicalizer_facts
from uniforce_vtla.tokenizer.entry import prepare_tensor
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.model import ForceAutoencoder, ReferenceCache, build_model
from uniforce_vtla.tokenizer.weights import SIZES, content_hash

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import (
        PI05UniforceConfig,
        TouchSettings,
    )

# its tensors in a policy; stored only where the package doesn't have them
ENCODER = "model.tactile_encoder."


class TactileEncoder(nn.Module):
    """A frozen tokenizer, always in eval mode; its decoder is kept too, so that its hash can be checked.

    ``head`` reads newtons in its latents, frozen too; None where the policy feels with the latents themselves.
    """

    def __init__(
        self, model: ForceAutoencoder, grid: int, head: ForceRegressor | None = None
    ) -> None:
        super().__init__()
        self.model, self.grid, self.head = model, grid, head
        # and the finger compared
        self.references: ReferenceMemory[ReferenceCache] = ReferenceMemory(len(SLOTS) + 1)
        self.requires_grad_(False)
        self.train(False)

    def train(self, mode: bool = True) -> TactileEncoder:
        """Stay in eval mode: LeRobot calls ``policy.train()`` at every step."""
        return super().train(False)

    @torch.no_grad()
    def forward(self, slot: str, finger: Finger, reference: Tensor, current: Tensor) -> Tensor:
        """Return (B, K, latent) pooled latents of a slot's pair, (B, H, W) each in [0, 1].

        The slot is the key of the reference cache, the finger that wears the sensor decides the mirror.
        """
        encode = functools.partial(self._encode_reference, slot, finger, reference)
        cached = self.references.get((slot, finger), reference, encode)
        latent = self.model.encoder.encode_current(
            cached, self._prepare(current, finger, "current")
        ).mean
        return pool_latent(latent, self.grid)

    def _encode_reference(self, slot: str, finger: Finger, reference: Tensor) -> ReferenceCache:
        before = self._prepare(reference, finger, "reference")
        if not bool((before.amax(dim=(1, 2, 3)) > 0).all()):
            do = "Capture it again in free air."
            raise ContractError(
                expected(f"reference of {slot}", "an image with markers", "all black", do)
            )
        return self.model.encoder.encode_reference(before)

    def _prepare(self, images: Tensor, finger: Finger, name: str) -> Tensor:
        return prepare_tensor(
            images, right=finger == "right", side=self.model.config.side, name=name
        )


@functools.cache
def packaged_hashes() -> dict[str, str]:
    """Return content hash → size of the tokenizers that come with the package."""
    return {Tokenizer.from_pretrained(size).hash: size for size in SIZES}


def is_packaged(config: PI05UniforceConfig) -> bool:
    """Return whether the policy's tokenizer comes with the package, so that its checkpoint holds only the hash."""
    return bool(config.tokenizer_hash) and config.tokenizer_hash in packaged_hashes()


def build_encoder(config: PI05UniforceConfig, empty: bool = False) -> TactileEncoder:
    """Make a new policy's encoder and write its facts into the config, or the one a checkpoint's config knows.

    Tokenizer and head are the packaged ones of their hash, or rebuilt, ``empty``, and filled from the checkpoint.

    Raises CheckpointError: made behind another canonicalizer, or as ``read_head``.
    """
    model = _build_tokenizer(config, empty)
    head = _build_head(config, empty) if config.touch.input == "newtons" else None
    return TactileEncoder(model, config.latent_grid, head)


def _build_tokenizer(config: PI05UniforceConfig, empty: bool) -> ForceAutoencoder:
    facts = config.touch.tokenizer
    if facts is not None and is_packaged(config):
        return Tokenizer.from_pretrained(packaged_hashes()[config.tokenizer_hash]).model
    if facts is None:
        tokenizer = Tokenizer.from_pretrained(config.touch.tokenizer_path)
        config.touch.tokenizer = {**tokenizer.facts(), "hash": tokenizer.hash}
        return tokenizer.model
    stored, running = facts.get(STORED_KEY), canonicalizer_facts()
    if stored != running:
        do = "Use the version it was trained with, or train again."
        raise CheckpointError(expected("canonicalizer of the checkpoint", stored, running, do))
    with no_weights() if empty else nullcontext():
        return build_model(TokenizerConfig(**facts["model"]), seed=0)


def _build_head(config: PI05UniforceConfig, empty: bool) -> ForceRegressor:
    touch = config.touch
    if touch.head_sizes is not None:
        with no_weights() if empty else nullcontext():
            return ForceRegressor(HeadConfig(**touch.head_sizes))
    head = read_head(touch, config.tokenizer_hash)
    found = head.hash
    if (trained_with := touch.head_hash or found) != found:
        do = "Use the version it was trained with, or train again."
        raise CheckpointError(expected(f"force head of {touch.head}", trained_with, found, do))
    touch.head_hash = found
    touch.head_sizes = None if is_packaged(config) else asdict(head.model.config)
    return head.model


def read_head(touch: TouchSettings, tokenizer_hash: str) -> ForceHead:
    """Return the force head of a kind of sensor: the package's, or the one beside a tokenizer of one's own.

    Raises CheckpointError: no such head, or one of another tokenizer.
    """
    # a path in a checkpoint is never followed
    beside = None if touch.head_hash else touch.tokenizer_path
    try:
        head = ForceHead.from_pretrained(
            touch.head, packaged_hashes().get(tokenizer_hash) or beside
        )
    except CheckpointError as error:
        do = "Let `uniforce pretrain` fit one, use a packaged tokenizer, or touch.input=latent."
        raise CheckpointError(
            expected("touch.head", f"a force head of {touch.head}", error, do)
        ) from error
    if head.tokenizer_hash != tokenizer_hash:
        came, do = head.tokenizer_hash, "Fit a head to this tokenizer, or use touch.input=latent."
        raise CheckpointError(
            expected(f"tokenizer of the force head of {touch.head}", tokenizer_hash, came, do)
        )
    return head


def check_hash(encoder: TactileEncoder, config: PI05UniforceConfig) -> None:
    """Raise CheckpointError unless loaded tokenizer and head are, bit by bit, those the policy was trained with."""
    facts = {name: fact for name, fact in (config.touch.tokenizer or {}).items() if name != "hash"}
    found = content_hash(encoder.model, facts)
    if found != config.tokenizer_hash:
        do = "The tokenizer inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("tokenizer hash", config.tokenizer_hash, found, do))
    if encoder.head is None:
        return
    found = ForceHead(encoder.head, config.touch.head, config.tokenizer_hash).hash
    if found != config.touch.head_hash:
        do = "The head inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("force head hash", config.touch.head_hash, found, do))
