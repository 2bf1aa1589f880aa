"""Once per observation: cameras, text and extra tokens through the VLM, kept as keys and values of every layer."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler import layers as ops
from lerobot_policy_pi05_uniforce.sampler.layers import Prepared
from lerobot_policy_pi05_uniforce.touch.felt import NOTHING, Felt
from lerobot_policy_pi05_uniforce.touch.tokens import GatedColumns, SuffixTouch


class Inputs(NamedTuple):
    """An observation: cameras, text, state and touch."""

    images: list  # (B, 3, H, W) each
    img_masks: list  # (B,) bool each
    tokens: Tensor  # (B, L) text
    masks: Tensor  # (B, L) bool
    felt: Felt = NOTHING


@dataclass(frozen=True)
class Prefill:
    """Cameras, text and extra tokens after the VLM."""

    # per layer (B, 2, L_prefix + L_suffix, head): key and value, the suffix's places still empty
    cache: list[Tensor]
    pads: Tensor  # (B, L_prefix) bool, which kept tokens are real
    gated: GatedColumns | None  # the weight of touch, or None: as any other token


@dataclass(frozen=True)
class Prefix:
    """A prefill ready for the flow: with touch in the suffix, and how the suffix attends."""

    prefill: Prefill  # keys and values; the suffix's own take their places in every step
    touch: SuffixTouch | None  # force tokens in front of the actions, or None
    # (B, 1, 1 or L_suffix, L_prefix + L_suffix), bool or (touch behind a gate) additive; None: all see all
    mask: Tensor | None
    # of the suffix's positions, for queries, key and value; the value's turns nothing
    rotary: ops.Rotary


class PrefixEncoder:
    """Makes prefixes for one network."""

    def __init__(self, network: stock.PI05Pytorch, prepared: Prepared) -> None:
        self._network = network
        self._prepared = prepared

    def encode(self, inputs: Inputs, chunk: int) -> Prefix:
        """Encode an observation and make its prefix ready for a chunk of that many steps."""
        touch = self._network.suffix_touch(inputs.felt)
        room = chunk + (0 if touch is None else touch.mask.shape[1])
        return self.with_suffix(self.prefill(inputs, room), touch, chunk)

    def prefill(self, inputs: Inputs, room: int, always_mask: bool = False) -> Prefill:
        """Run cameras, text and extra tokens through the VLM once and keep keys and values of every layer.

        Args:
            inputs: of the observation.
            room: places to leave for the suffix.
            always_mask: don't ask whether all tokens are real, which would wait for the device.
        """
        eps, gains = self._prepared.eps, self._prepared.gains
        vlm = self._network.paligemma_with_expert.paligemma.model.language_model
        x, pads, gated = self._embed(inputs)
        x = x.to(vlm.layers[0].self_attn.q_proj.weight.dtype)
        plain = not always_mask and bool(pads.all())
        mask = None if plain else pads[:, None, None, :]  # what a padded token sees is not read
        if gated is not None and gated.first < pads.shape[1]:  # touch is in the prefix
            mask = _additive(mask, pads, gated, x.dtype)
        rotary, cache = ops.rotary_of(vlm, x, _positions(pads, gated)), []
        for depth, layer in enumerate(vlm.layers):
            turned = ops.rotated(ops.project(layer, ops.rms(x, eps).mul_(gains[depth][0])), rotary)
            cache.append(F.pad(turned[:, -2:], (0, 0, 0, room)))
            if depth == len(vlm.layers) - 1:
                break  # what the last layer makes of the prefix is not read
            mixed = ops.attend(turned[:, :-2], turned[:, -2:], mask)
            x = ops.linear_plus(mixed, layer.self_attn.o_proj.weight, None, x)
            normed = ops.rms(x, eps).mul_(gains[depth][1]).to(x.dtype)
            x = ops.linear_plus(
                ops.gated_hidden(layer.mlp, normed), layer.mlp.down_proj.weight, None, x
            )
        return Prefill(cache, pads, gated)

    def with_suffix(
        self, prefill: Prefill, touch: SuffixTouch | None, chunk: int, always_mask: bool = False
    ) -> Prefix:
        """Return whom the suffix attends to and where it stands; ``always_mask`` as in :meth:`prefill`."""
        expert = self._network.paligemma_with_expert.gemma_expert.model
        gated, behind = prefill.gated, prefill.pads.new_ones(len(prefill.pads), chunk)
        if touch is not None:
            gated = None if gated is None else replace(gated, real=touch.mask)
            behind = torch.cat([touch.mask, behind], dim=1)  # (B, L_suffix)
        real = torch.cat([prefill.pads, behind], dim=1)  # (B, L_prefix + L_suffix)
        after = _positions(real, gated)[:, prefill.pads.shape[1] :]
        columns = real[:, None, None, :]
        mask = None if touch is None and not always_mask and bool(columns.all()) else columns
        if touch is not None:  # touch sees the prefix and itself, actions see everything
            rows = real.new_ones(behind.shape[1], columns.shape[-1])
            rows[: touch.mask.shape[1], -chunk:].fill_(False)
            mask = columns & rows
        mask = _additive(mask, real, gated, prefill.cache[0].dtype)
        return Prefix(prefill, touch, mask, ops.rotary_of(expert, prefill.cache[0], after))

    def _embed(self, inputs: Inputs) -> tuple[Tensor, Tensor, GatedColumns | None]:
        """Return (B, L, D) tokens in LeRobot's order, (B, L) whether each is real, and the weight of touch."""
        model = self._network.paligemma_with_expert
        parts: list[Tensor] = []
        if inputs.images:
            cameras = ops.embed_cameras(model.paligemma.model, torch.cat(inputs.images))
            parts += cameras.chunk(len(inputs.images))
        pads = [
            mask[:, None].expand(-1, part.shape[1])
            for part, mask in zip(parts, inputs.img_masks, strict=True)
        ]
        parts.append(model.embed_language_tokens(inputs.tokens))
        pads.append(inputs.masks.bool())
        before = sum(part.shape[1] for part in parts)
        behind, gated = self._network.embed_felt(inputs.felt, before)
        for part, mask in behind:
            parts.append(part.to(parts[0].dtype))
            pads.append(mask[:, None].expand(-1, part.shape[1]))
        return torch.cat(parts, dim=1), torch.cat(pads, dim=1), gated


def drop_dead(inputs: Inputs) -> Inputs:
    """Leave out cameras no row of the batch has, and text columns no prompt of the batch uses.

    Positions count real tokens only, and masked ones are not attended to, so nothing else changes.
    """
    kept = [number for number, mask in enumerate(inputs.img_masks) if bool(mask.any())]
    images = [inputs.images[number] for number in kept]
    img_masks = [inputs.img_masks[number] for number in kept]
    tokens, masks = drop_padding(inputs.tokens, inputs.masks)
    return Inputs(images, img_masks, tokens, masks, inputs.felt)


def drop_padding(tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
    """Return text (B, L) and its mask without the columns that no prompt of the batch uses."""
    used = int(masks.any(dim=0).nonzero().max()) + 1 if bool(masks.any()) else 0
    return tokens[:, :used], masks[:, :used]


def _positions(real: Tensor, gated: GatedColumns | None) -> Tensor:
    """Return (B, L) positions: real tokens counted, touch behind a gate not."""
    positions = real.cumsum(dim=1) - 1
    return positions if gated is None else gated.placed(positions, real.shape[1])


def _additive(
    mask: Tensor | None, real: Tensor, gated: GatedColumns | None, dtype: torch.dtype
) -> Tensor | None:
    """Return a bool mask (B, 1, rows, L) as an additive one with touch's logits; unchanged without a gate."""
    if gated is None:
        return mask
    seen = real.new_ones(1, 1, 1, real.shape[1]) if mask is None else mask
    additive = torch.zeros(seen.shape, device=real.device).masked_fill_(~seen, -torch.inf)
    return gated.masked(additive).to(dtype)
