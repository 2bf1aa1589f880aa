"""The frozen tokenizer and force head inside a policy: built, or loaded, and checked."""

import copy
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any, Self

import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.cuda_graphs import Recording, Recordings
from lerobot_policy_pi05_uniforce.weights import no_weights
from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.tokenizer import Tokenizer, TokenizerConfig
from uniforce_vtla.tokenizer.api import (
    MOST_REMEMBERED,
    STORED_KEY,
    canonicalizer_facts,
    shipped_sizes,
)
from uniforce_vtla.tokenizer.force_head import ForceHead, ForceRegressor, HeadConfig
from uniforce_vtla.tokenizer.model import Encoder, Posterior, ReferenceCache, build_model
from uniforce_vtla.tokenizer.weights import content_hash

# its tensors in a policy; stored only where the package doesn't have them
ENCODER = "model.tactile_encoder."


class ReplayedEncoder:
    """``Encoder.encode_current``, on CUDA replayed from a graph: a hundred small kernels a finger.

    Attributes:
        device: type of the devices on which it is recorded; on others it is called.
    """

    def __init__(self, encoder: Encoder) -> None:
        self.device = "cuda"
        self.recordings = Recordings()
        self._encode = encoder.encode_current

    def __call__(self, reference: ReferenceCache, current: Tensor) -> Posterior:
        """Return the posterior of (B, 1, S, S) current images."""
        if current.device.type != self.device or len(current) > MOST_REMEMBERED:
            return self._encode(reference, current)
        record = partial(self._record, reference, current)
        mean, log_variance = self.recordings.call((), _flattened(reference, current), record)
        return Posterior(mean, log_variance)

    def _record(self, reference: ReferenceCache, current: Tensor) -> Recording:
        before, after = copy.deepcopy((reference, current))

        def encoded() -> Tensor:
            return torch.stack(self._encode(before, after))

        return Recording(encoded, _flattened(before, after), self.recordings.capture)


def _flattened(reference: ReferenceCache, current: Tensor) -> list[Tensor]:
    tensors = [current, reference.image, *reference.halved]
    for kept in reference.kept:
        tensors += kept
    return tensors


class FrozenTokenizer(nn.Module):
    """The frozen tokenizer and force head as modules of a policy, which moves and stores them.

    The decoder is kept too, so that the tokenizer's hash can be checked.

    Args:
        tokenizer: encodes.
        head: force head that reads newtons; None where the policy feels latents.
        replays: replay the encoder on CUDA.
    """

    def __init__(self, tokenizer: Tokenizer, head: ForceHead | None, replays: bool = False) -> None:
        super().__init__()
        encoder: Any = tokenizer.model.encoder
        self.replayed = ReplayedEncoder(encoder)
        if replays:
            encoder.encode_current = self.replayed
        self.tokenizer = tokenizer
        self.force_head = head
        # names of their tensors in every checkpoint
        self.model = tokenizer.model
        self.head = None if head is None else head.model
        self.requires_grad_(False)
        self.eval()

    def train(self, mode: bool = True) -> Self:
        """Stay in eval mode: LeRobot calls ``policy.train()`` at every step."""
        return super().train(False)

    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> Self:
        """Move; recordings point to where the weights were."""
        self.replayed.recordings.kept.clear()
        return super()._apply(fn, recurse)


def is_packaged(config: PI05UniforceConfig) -> bool:
    """Return whether the tokenizer comes with the package: checkpoints then hold its hash only."""
    return bool(config.tokenizer_hash) and config.tokenizer_hash in shipped_sizes()


def build_frozen_touch(config: PI05UniforceConfig, empty: bool) -> FrozenTokenizer:
    """Make a new policy's frozen networks and note them in the config, or those that it names.

    Tokenizer and head are the packaged ones of their hash, or rebuilt; ``empty`` where the
    checkpoint fills them.

    Raises CheckpointError: made behind another canonicalizer; no such head, or another's.
    """
    tokenizer = _build_tokenizer(config, empty)
    head = None
    if config.reads_newtons:
        head = _build_head(config, empty)
    return FrozenTokenizer(tokenizer, head, config.sampler.kind == "fast")


def _build_tokenizer(config: PI05UniforceConfig, empty: bool) -> Tokenizer:
    facts = config.touch.tokenizer
    if is_packaged(config):
        return Tokenizer.from_pretrained(shipped_sizes()[config.tokenizer_hash])
    if facts is None or not empty:
        tokenizer = Tokenizer.from_pretrained(config.touch.tokenizer_path)
        if facts is not None and tokenizer.hash != config.tokenizer_hash:
            do = "Name the tokenizer that these settings were made with."
            wanted = config.tokenizer_hash
            raise CheckpointError(expected("touch.tokenizer_path", wanted, tokenizer.hash, do))
        config.touch.tokenizer = {**tokenizer.facts(), "hash": tokenizer.hash}
        return tokenizer
    stored = facts.get(STORED_KEY)
    running = canonicalizer_facts()
    if stored != running:
        do = "Use the version it was trained with, or train again."
        raise CheckpointError(expected("canonicalizer of the checkpoint", stored, running, do))
    with no_weights():
        model = build_model(TokenizerConfig(**facts["model"]), seed=0)
    return Tokenizer(model, known_hash=config.tokenizer_hash)


def _build_head(config: PI05UniforceConfig, empty: bool) -> ForceHead:
    """Return the head of a sensor type: of the checkpoint, the package, or one's own tokenizer."""
    touch = config.touch
    if touch.head_sizes is not None and empty:
        with no_weights():
            model = ForceRegressor(HeadConfig(**touch.head_sizes))
        return ForceHead(model, touch.head, config.tokenizer_hash)
    # a path in a checkpoint is never followed
    beside = None if touch.head_hash and empty else touch.tokenizer_path
    size = shipped_sizes().get(config.tokenizer_hash)
    try:
        head = ForceHead.from_pretrained(touch.head, size or beside)
    except CheckpointError as error:
        wanted = f"a force head of {touch.head}"
        do = "Let `uniforce pretrain` fit one, use a packaged tokenizer, or touch.input=latent."
        raise CheckpointError(expected("touch.head", wanted, error, do)) from error
    if head.tokenizer_hash != config.tokenizer_hash:
        name = f"tokenizer of the force head of {touch.head}"
        do = "Fit a head to this tokenizer, or use touch.input=latent."
        raise CheckpointError(expected(name, config.tokenizer_hash, head.tokenizer_hash, do))
    if touch.head_hash not in ("", head.hash):
        do = "Use the version it was trained with, or train again."
        name = f"force head of {touch.head}"
        raise CheckpointError(expected(name, touch.head_hash, head.hash, do))
    touch.head_hash = head.hash
    if not is_packaged(config):
        touch.head_sizes = asdict(head.model.config)
    return head


def check_hash(frozen: FrozenTokenizer, config: PI05UniforceConfig) -> None:
    """Raise CheckpointError unless tokenizer and head are, bit by bit, those of the training."""
    facts = dict(config.touch.tokenizer or {})
    facts.pop("hash", None)
    found = content_hash(frozen.model, facts)
    if found != config.tokenizer_hash:
        do = "The tokenizer inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("tokenizer hash", config.tokenizer_hash, found, do))
    if frozen.force_head is not None and frozen.force_head.hash != config.touch.head_hash:
        found = frozen.force_head.hash
        do = "The head inside the checkpoint was changed; copy the checkpoint again."
        raise CheckpointError(expected("force head hash", config.touch.head_hash, found, do))
