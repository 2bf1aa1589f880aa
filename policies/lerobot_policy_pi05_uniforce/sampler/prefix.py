"""Once per observation: cameras, text and felt tokens through the VLM, kept as keys and values."""

from dataclasses import dataclass
from itertools import compress

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.network import Inputs, PI05UniforcePytorch, drop_padding
from lerobot_policy_pi05_uniforce.sampler import layers as ops
from lerobot_policy_pi05_uniforce.sampler.layers import Prepared
from lerobot_policy_pi05_uniforce.touch.tokens import GatedColumns


@dataclass(frozen=True)
class Prefix:
    """An observation after the VLM, and how a chunk's rows attend to it."""

    # per layer (B, 2, length + chunk, head): key and value; each flow step writes the chunk's own
    cache: list[Tensor]
    length: int  # of the prefix
    mask: Tensor | None  # (B, 1, 1, length + chunk) additive; None: all see all
    rotary: ops.Rotary  # of the chunk's positions, for queries, key and value


def encode(
    network: PI05UniforcePytorch,
    prepared: Prepared,
    inputs: Inputs,
    chunk: int,
    always_mask: bool = False,
) -> Prefix:
    """Run an observation through the VLM and keep every layer's keys and values.

    Args:
        network: whose VLM encodes.
        prepared: of its weights.
        inputs: of the observation.
        chunk: steps of the chunk, for which places are left.
        always_mask: don't ask whether all tokens are real, which would wait for the device.
    """
    vlm = network.vlm
    seen, seen_real = _seen(network, prepared, inputs)
    x, real, gated = network.append_felt(inputs.felt, seen, seen_real)
    x = x.to(prepared.dtype)  # (B, L, D)
    length = x.shape[1]
    whole = F.pad(real, (0, chunk), value=True)  # (B, L + chunk)
    mask = None
    chunk_mask = None
    if always_mask or gated is not None or not real.all():
        mask = _additive(real, gated).to(x.dtype)
        chunk_mask = _additive(whole, gated)
    positions = whole.cumsum(dim=1) - 1
    if gated is not None:  # touch behind a gate takes no place
        positions = gated.placed(positions, whole.shape[1])
    rotary = ops.rotary_of(vlm, x, positions[:, :length])
    cache = []
    for depth, layer in enumerate(vlm.layers):
        a = layer.self_attn
        normed = ops.rms(x, prepared.eps).mul_(prepared.gains[depth][0]).to(x.dtype)
        rows = torch.cat([a.q_proj(normed), a.k_proj(normed), a.v_proj(normed)], dim=-1)
        turned = ops.rotated(rows, rotary, a.head_dim)  # (B, heads + 2, L, head)
        cache.append(F.pad(turned[:, -2:], (0, 0, 0, chunk)))
        if depth == len(vlm.layers) - 1:
            break  # the last layer's output for the prefix is not read
        x = x + a.o_proj(ops.attend(turned[:, :-2], turned[:, -2:], mask))
        x = x + layer.mlp(ops.rms(x, prepared.eps).mul_(prepared.gains[depth][1]).to(x.dtype))
    chunk_rotary = ops.rotary_of(network.expert, x, positions[:, length:])
    return Prefix(cache, length, chunk_mask, chunk_rotary)


def _seen(
    network: PI05UniforcePytorch, prepared: Prepared, inputs: Inputs
) -> tuple[Tensor, Tensor]:
    """Return (B, L, D) tokens of cameras and text, and (B, L) whether each is real."""
    parts = [network.paligemma_with_expert.embed_language_tokens(inputs.tokens)]
    reals = [inputs.masks.bool()]
    if inputs.images:
        images = torch.cat(inputs.images).to(prepared.dtype)  # (cameras · B, 3, H, W)
        patches = prepared.projector(prepared.tower(images).last_hidden_state)
        parts = [*patches.chunk(len(inputs.images)), *parts]
        present = torch.stack(inputs.img_masks, dim=1)  # (B, cameras)
        reals = [present.repeat_interleave(patches.shape[1], dim=1), *reals]
    return torch.cat(parts, dim=1), torch.cat(reals, dim=1)


def _additive(real: Tensor, gated: GatedColumns | None) -> Tensor:
    """Return a mask (B, 1, 1, L) float32: 0 or a gate's logit where a token is real, else −inf."""
    mask = torch.zeros(real.shape, device=real.device).masked_fill_(~real, -torch.inf)
    mask = mask[:, None, None]
    return mask if gated is None else gated.masked(mask)


def drop_dead(inputs: Inputs) -> Inputs:
    """Leave out cameras no row of the batch has, and text columns no prompt of the batch uses.

    Positions count real tokens only, and masked ones are not attended to, so nothing else changes.
    """
    there = torch.stack(inputs.img_masks).any(dim=1).cpu().tolist()
    images = list(compress(inputs.images, there))
    img_masks = list(compress(inputs.img_masks, there))
    return Inputs(images, img_masks, *drop_padding(inputs.tokens, inputs.masks), inputs.felt)
