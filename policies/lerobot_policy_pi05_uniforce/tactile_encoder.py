"""The frozen tactile tokenizer inside a policy: marker images → pooled latents, references encoded once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from uniforce_vtla.contracts import Finger
from uniforce_vtla.tokenizer import Tokenizer, pool_latent, prepare_tensor

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig


class TactileEncoder(nn.Module):
    """A frozen tokenizer: no gradients, always in eval mode, saved with the policy so that it stands alone.

    Args:
        model: the tokenizer's network (``encode_reference``, ``encode_current``).
        side: model image side in px.
        grid: latents are pooled to grid × grid.
    """

    def __init__(self, model: nn.Module, side: int, grid: int) -> None:
        super().__init__()
        self.model = model
        self.side = side
        self.grid = grid
        self._references: dict[str, tuple[Tensor, Any]] = {}
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
        latent = self.model.encode_current(self._prepare(current, finger), cached)  # (B, P, latent)
        return pool_latent(latent, self.grid)  # (B, K, latent)

    def _encode_reference(self, slot: str, finger: Finger, reference: Tensor) -> Any:
        key = f"{slot}/{finger}"
        known = self._references.get(key)
        if known is None or not torch.equal(known[0], reference):
            known = (reference.clone(), self.model.encode_reference(self._prepare(reference, finger)))
            self._references[key] = known
        return known[1]

    def _prepare(self, images: Tensor, finger: Finger) -> Tensor:
        grey = images[:, 0] if images.ndim == 4 else images  # RGB copies of one binary channel
        return prepare_tensor(grey.float(), right=finger == "right", side=self.side)


def build_encoder(config: PI05UniforceConfig) -> TactileEncoder:
    """Make the encoder a config asks for and write the tokenizer's facts into that config.

    A config loaded from a checkpoint already knows its tokenizer: it is rebuilt empty and its weights come from
    the checkpoint.  A new policy takes the tokenizer at ``tokenizer_path`` (None: the shipped one).
    """
    if config.tokenizer_config is None:
        tokenizer = Tokenizer.from_pretrained(config.tokenizer_path)
        config.tokenizer_config = tokenizer.config_dict()
        config.tokenizer_hash = tokenizer.hash
        config.num_patches = tokenizer.num_patches
        config.latent_size = tokenizer.latent_size
    else:
        tokenizer = Tokenizer.from_config(config.tokenizer_config)
    return TactileEncoder(tokenizer.model, tokenizer.side, config.latent_grid)
