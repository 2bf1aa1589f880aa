"""The frozen tokenizer and force head inside a policy: built anew or from its checkpoint, compared by their hashes."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import asdict
from typing import TYPE_CHECKING

from torch import nn

from lerobot_policy_pi05_uniforce.weights import no_weights
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.api import STORED_KEY, canonicalizer_facts, shipped_sizes
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.model import build_model
from uniforce_vtla.tokenizer.weights import content_hash

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import (
        PI05UniforceConfig,
        TouchSettings,
    )

# its tensors in a policy; stored only where the package doesn't have them
ENCODER = "model.tactile_encoder."


class FrozenTouch(nn.Module):
    """The frozen tokenizer and force head as modules of a policy, which moves and stores them; in eval mode.

    The decoder is kept too, so that the tokenizer's hash can be checked.

    Args:
        tokenizer: it, which encodes.
        head: force head that reads newtons; None where the policy feels with the latents themselves.
    """

    def __init__(self, tokenizer: Tokenizer, head: ForceHead | None = None) -> None:
        super().__init__()
        self.tokenizer = tokenizer
        self.force_head = head
        # names of their tensors in every checkpoint
        self.model = tokenizer.model
        self.head = None if head is None else head.model
        self.requires_grad_(False)
        self.train(False)

    def train(self, mode: bool = True) -> FrozenTouch:
        """Stay in eval mode: LeRobot calls ``policy.train()`` at every step."""
        return super().train(False)


def is_packaged(config: PI05UniforceConfig) -> bool:
    """Return whether the policy's tokenizer comes with the package, so that its checkpoint holds only the hash."""
    return bool(config.tokenizer_hash) and config.tokenizer_hash in shipped_sizes()


def build_frozen_touch(config: PI05UniforceConfig, empty: bool = False) -> FrozenTouch:
    """Make a new policy's frozen networks and note them in the config, or those a checkpoint's config names.

    Tokenizer and head are the packaged ones of their hash, or rebuilt, ``empty``, and filled from the checkpoint.

    Raises CheckpointError: made behind another canonicalizer, or as ``read_head``.
    """
    tokenizer = _build_tokenizer(config, empty)
    head = _build_head(config, empty) if config.touch.input == "newtons" else None
    return FrozenTouch(tokenizer, head)


def _build_tokenizer(config: PI05UniforceConfig, empty: bool) -> Tokenizer:
    facts = config.touch.tokenizer
    if facts is not None and is_packaged(config):
        return Tokenizer.from_pretrained(shipped_sizes()[config.tokenizer_hash])
    if facts is None:
        tokenizer = Tokenizer.from_pretrained(config.touch.tokenizer_path)
        config.touch.tokenizer = {**tokenizer.facts(), "hash": tokenizer.hash}
        return tokenizer
    stored, running = facts.get(STORED_KEY), canonicalizer_facts()
    if stored != running:
        do = "Use the version it was trained with, or train again."
        raise CheckpointError(expected("canonicalizer of the checkpoint", stored, running, do))
    with no_weights() if empty else nullcontext():
        model = build_model(TokenizerConfig(**facts["model"]), seed=0)
    return Tokenizer(model, known_hash=config.tokenizer_hash)


def _build_head(config: PI05UniforceConfig, empty: bool) -> ForceHead:
    touch = config.touch
    if touch.head_sizes is not None:
        with no_weights() if empty else nullcontext():
            model = ForceRegressor(HeadConfig(**touch.head_sizes))
        return ForceHead(model, touch.head, config.tokenizer_hash)
    head = read_head(touch, config.tokenizer_hash)
    found = head.hash
    if (trained_with := touch.head_hash or found) != found:
        do = "Use the version it was trained with, or train again."
        raise CheckpointError(expected(f"force head of {touch.head}", trained_with, found, do))
    touch.head_hash = found
    touch.head_sizes = None if is_packaged(config) else asdict(head.model.config)
    return head


def read_head(touch: TouchSettings, tokenizer_hash: str) -> ForceHead:
    """Return the force head of a kind of sensor: the package's, or the one beside a tokenizer of one's own.

    Raises CheckpointError: no such head, or one of another tokenizer.
    """
    # a path in a checkpoint is never followed
    beside = None if touch.head_hash else touch.tokenizer_path
    try:
        head = ForceHead.from_pretrained(touch.head, shipped_sizes().get(tokenizer_hash) or beside)
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


def check_hash(frozen: FrozenTouch, config: PI05UniforceConfig) -> None:
    """Raise CheckpointError unless loaded tokenizer and head are, bit by bit, those the policy was trained with."""
    facts = {name: fact for name, fact in (config.touch.tokenizer or {}).items() if name != "hash"}
    found = content_hash(frozen.model, facts)
    if found != config.tokenizer_hash:
        do = "The tokenizer inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("tokenizer hash", config.tokenizer_hash, found, do))
    if frozen.force_head is None:
        return
    found = frozen.force_head.hash
    if found != config.touch.head_hash:
        do = "The head inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("force head hash", config.touch.head_hash, found, do))
