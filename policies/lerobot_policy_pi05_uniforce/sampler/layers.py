"""Arithmetic of the fast sampler: SigLIP, norms, rotations and attention, without copies LeRobot's layers make."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler.onednn import attend_one, linear, linear_gelu, linear_plus, suits

Rotary = tuple[Tensor, Tensor]  # cos, and sin with the sign rotate_half would give; (B, heads, L, head) each


class Modulation(NamedTuple):
    """One adaptive norm at one flow time: normed · scale + shift, and the gate of what follows; (D,) each."""

    scale: Tensor
    shift: Tensor
    gate: Tensor


def modulated(x: Tensor, by: Modulation, eps: Tensor) -> Tensor:
    """Return an adaptive norm of ``x`` (…, D), in ``x``'s own dtype."""
    return torch.addcmul(by.shift, rms(x, eps), by.scale).to(x.dtype)


def rms(x: Tensor, eps: Tensor) -> Tensor:
    """Return ``x`` over its root mean square, in float32 as LeRobot computes it; ``eps`` a number in a tensor."""
    wide = x.float()
    norm = torch.linalg.vector_norm(wide, dim=-1, keepdim=True)
    return wide * torch.rsqrt(torch.addcmul(eps, norm, norm, value=1 / x.shape[-1]))


def project(layer: nn.Module, normed: Tensor) -> Tensor:
    """Return (B, heads + 2, L, head): queries, key, value."""
    a = layer.self_attn
    normed = normed.to(a.q_proj.weight.dtype)
    rows = torch.cat([linear(normed, p.weight) for p in (a.q_proj, a.k_proj, a.v_proj)], dim=-1)
    return rows.unflatten(-1, (-1, a.head_dim)).transpose(1, 2)


def rotary_of(model: nn.Module, x: Tensor, positions: Tensor) -> Rotary:
    """Return cos and signed sin for (B, heads + 2, L, head) rows: queries also scaled, the value left as it is."""
    cos, sin = model.rotary_emb(x, positions)  # (B, L, head)
    half = cos.shape[-1] // 2
    sin = torch.cat([-sin[..., :half], sin[..., half:]], dim=-1)
    heads, scale = model.config.num_attention_heads, model.layers[0].self_attn.scaling
    queries = [(part * scale)[:, None].expand(-1, heads, -1, -1) for part in (cos, sin)]
    still = torch.ones_like(cos)[:, None], torch.zeros_like(sin)[:, None]
    return tuple(  # type: ignore[return-value]
        torch.cat([queries[n], part[:, None], still[n]], dim=1) for n, part in enumerate((cos, sin))
    )


def rotated(rows: Tensor, rotary: Rotary) -> Tensor:
    """Return rows turned by their positions: x·cos + swap(x)·signed sin, halves swapped by rolling."""
    cos, sin = rotary
    return torch.addcmul(rows * cos, rows.roll(rows.shape[-1] // 2, dims=-1), sin)


def attend(q: Tensor, cache: Tensor, mask: Tensor | None) -> Tensor:
    """Return (B, L, heads·head) of scaled (B, heads, L, head) queries; one key/value head serves all of them."""
    if suits(q, cache.shape[2]):
        mixed = attend_one(q, cache[0, 0], cache[0, 1], mask)
    else:
        k, v = (cache[:, n : n + 1].expand(-1, q.shape[1], -1, -1) for n in (0, 1))
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=mask, scale=1.0)
    return mixed.transpose(1, 2).flatten(2)


def embed_cameras(paligemma: nn.Module, images: Tensor) -> Tensor:
    """Return (cameras, patches, D) tokens of (cameras, 3, H, W) images in [−1, 1], all in one batch.

    Args:
        paligemma: PaliGemma's ``model``: vision tower and projector, in float32 as LeRobot keeps them.
        images: of the resolution the tower was built for.
    """
    tower = paligemma.vision_tower
    tower = getattr(tower, "vision_model", tower)  # transformers moved it: a wrapper or the tower itself
    x = tower.embeddings(images.float())
    for layer in tower.encoder.layers:
        x = _vision_attention(layer.self_attn, _normed(layer.layer_norm1, x), x)
        mlp = layer.mlp
        hidden = linear_gelu(_normed(layer.layer_norm2, x), mlp.fc1.weight, mlp.fc1.bias)
        x = linear_plus(hidden, mlp.fc2.weight, mlp.fc2.bias, x)
    head = paligemma.multi_modal_projector.linear
    return linear(_normed(tower.post_layernorm, x), head.weight, head.bias).to(images.dtype)


def _vision_attention(a: nn.Module, x: Tensor, residual: Tensor) -> Tensor:
    parts = [linear(x, p.weight, p.bias) for p in (a.q_proj, a.k_proj, a.v_proj)]
    q, k, v = (part.unflatten(-1, (-1, a.head_dim)).transpose(1, 2) for part in parts)  # (B, heads, L, head)
    mixed = F.scaled_dot_product_attention(q, k, v, scale=a.scale).transpose(1, 2).flatten(2)
    return linear_plus(mixed, a.out_proj.weight, a.out_proj.bias, residual)


def _normed(norm: nn.LayerNorm, x: Tensor) -> Tensor:
    return F.layer_norm(x, norm.normalized_shape, norm.weight, norm.bias, norm.eps)
