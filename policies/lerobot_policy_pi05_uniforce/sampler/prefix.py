"""Once per observation: cameras, text and felt tokens through the VLM, kept as keys and values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler import layers as ops
from lerobot_policy_pi05_uniforce.sampler.layers import Prepared
from lerobot_policy_pi05_uniforce.touch.tokens import NOTHING, Felt, GatedColumns

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch


class Inputs(NamedTuple):
    """An observation: cameras, text, state and touch."""

    images: list[Tensor]  # (B, 3, H, W) each
    img_masks: list[Tensor]  # (B,) bool each
    tokens: Tensor  # (B, L) text
    masks: Tensor  # (B, L) bool
    felt: Felt = NOTHING


@dataclass(frozen=True)
class Prefill:
    """Cameras, text and felt tokens after the VLM."""

    # per layer (B, 2, L_prefix + L_suffix, head): key and value, the suffix's places still empty
    cache: list[Tensor]
    real: Tensor  # (B, L_prefix) bool, False where a token is padding
    gated: GatedColumns | None  # the weight of touch, or None: as any other token

    def tensors(self) -> list[Tensor]:
        """Return every tensor in it."""
        gate = [] if self.gated is None else [self.gated.bias, self.gated.real]
        return [*self.cache, self.real, *gate]


@dataclass(frozen=True)
class Prefix:
    """A prefill ready for the flow, and how the suffix attends."""

    prefill: Prefill  # the suffix's own keys and values take their places in every step
    # (B, 1, 1, L_prefix + L_suffix), bool or additive; None: all see all
    mask: Tensor | None
    # of the suffix's positions, for queries, key and value; the value's turns nothing
    rotary: ops.Rotary


class PrefixEncoder:
    """Makes prefixes for one network."""

    def __init__(self, network: PI05UniforcePytorch, prepared: Prepared) -> None:
        self._network = network
        self._prepared = prepared

    def encode(self, inputs: Inputs, chunk: int) -> Prefix:
        """Encode an observation and make its prefix ready for a chunk of that many steps."""
        return self.with_suffix(self.prefill(inputs, chunk), chunk)

    def prefill(self, inputs: Inputs, room: int, always_mask: bool = False) -> Prefill:
        """Run cameras, text and felt tokens through the VLM; keep every layer's keys and values.

        Args:
            inputs: of the observation.
            room: places to leave for the suffix.
            always_mask: don't ask whether all tokens are real, which would wait for the device.
        """
        eps = self._prepared.eps
        gains = self._prepared.gains
        vlm = self._network.vlm
        x, real, gated = self._network.append_felt(inputs.felt, *self._seen(inputs))
        x = x.to(vlm.layers[0].self_attn.q_proj.weight.dtype)  # (B, L, D)
        mask = None
        if always_mask or not real.all():
            mask = real[:, None, None, :]  # the output of a padded token is not read
        mask = _additive(mask, real, gated, x.dtype)
        rotary = ops.rotary_of(vlm, x, _positions(real, gated))
        cache = []
        for depth, layer in enumerate(vlm.layers):
            rows = ops.project(layer, ops.rms(x, eps).mul_(gains[depth][0]))
            turned = ops.rotated(rows, rotary)  # (B, heads + 2, L, head)
            cache.append(F.pad(turned[:, -2:], (0, 0, 0, room)))
            if depth == len(vlm.layers) - 1:
                break  # the last layer's output for the prefix is not read
            mixed = ops.attend(turned[:, :-2], turned[:, -2:], mask)
            x = ops.linear_plus(mixed, layer.self_attn.o_proj.weight, None, x)
            normed = ops.rms(x, eps).mul_(gains[depth][1]).to(x.dtype)
            hidden = ops.gated_hidden(layer.mlp, normed)
            x = ops.linear_plus(hidden, layer.mlp.down_proj.weight, None, x)
        return Prefill(cache, real, gated)

    def with_suffix(self, prefill: Prefill, chunk: int, always_mask: bool = False) -> Prefix:
        """Return whom the suffix attends to and where it stands; arguments as ``prefill``'s."""
        gated = prefill.gated
        length = prefill.real.shape[1]
        behind = prefill.real.new_ones(len(prefill.real), chunk)
        real = torch.cat([prefill.real, behind], dim=1)  # (B, L_prefix + L_suffix)
        mask = None
        if always_mask or not real.all():
            mask = real[:, None, None, :]
        dtype = prefill.cache[0].dtype
        positions = _positions(real, gated)[:, length:]
        rotary = ops.rotary_of(self._network.expert, prefill.cache[0], positions)
        return Prefix(prefill, _additive(mask, real, gated, dtype), rotary)

    def _seen(self, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Return (B, L, D) tokens of cameras and text, and (B, L) whether each is real."""
        backbone = self._network.paligemma_with_expert
        parts = [backbone.embed_language_tokens(inputs.tokens)]
        reals = [inputs.masks.bool()]
        if inputs.images:
            cameras = ops.embed_cameras(backbone.paligemma.model, torch.cat(inputs.images))
            patches = cameras.shape[1]
            parts = [*cameras.chunk(len(inputs.images)), *parts]
            present = torch.stack(inputs.img_masks, dim=1)  # (B, cameras)
            reals = [present.repeat_interleave(patches, dim=1), *reals]
        return torch.cat(parts, dim=1), torch.cat(reals, dim=1)


def drop_dead(inputs: Inputs) -> Inputs:
    """Leave out cameras no row of the batch has, and text columns no prompt of the batch uses.

    Positions count real tokens only, and masked ones are not attended to, so nothing else changes.
    """
    images = []
    img_masks = []
    for image, mask in zip(inputs.images, inputs.img_masks, strict=True):
        if mask.any():
            images.append(image)
            img_masks.append(mask)
    return Inputs(images, img_masks, *drop_padding(inputs.tokens, inputs.masks), inputs.felt)


def drop_padding(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Return text (B, L) and its mask without the columns that no prompt of the batch uses."""
    used = 0
    if masks.any():
        used = int(masks.any(dim=0).nonzero().max()) + 1
    return tokens[:, :used], masks[:, :used]


def _positions(real: Tensor, gated: GatedColumns | None) -> Tensor:
    """Return (B, L) positions: real tokens counted, touch behind a gate not."""
    positions = real.cumsum(dim=1) - 1
    if gated is None:
        return positions
    return gated.placed(positions, real.shape[1])


def _additive(
    mask: Tensor | None, real: Tensor, gated: GatedColumns | None, dtype: torch.dtype
) -> Tensor | None:
    """Return a bool mask (B, 1, rows, L), with a gate an additive one that holds its logits."""
    if gated is None:
        return mask
    if mask is None:
        mask = real.new_ones(1, 1, 1, real.shape[1])
    additive = torch.zeros(mask.shape, device=real.device).masked_fill_(~mask, -torch.inf)
    return gated.masked(additive).to(dtype)
