"""Transformer layers of VLM and action expert, with torch's fused attention.

LeRobot's own loop builds every attention matrix, which on a CPU is half of a training step, and its sampling
path rebuilds masks and caches ten times per chunk.  Same weights, same mathematics, another order of summation:
equal within 1e-5 (tests compare them).
"""

from __future__ import annotations

import torch
from lerobot.policies.pi_gemma import _gated_residual, layernorm_forward
from torch import Tensor, nn
from transformers.models.gemma.modeling_gemma import apply_rotary_pos_emb

Streams = list[Tensor]  # VLM prefix (B, L0, D0) and expert suffix (B, L1, D1)


def joint_layer(
    streams: Streams,
    layers: list[nn.Module],
    mask: Tensor,
    rotary: tuple,
    cond: list,
    past: tuple[Tensor, Tensor] | None = None,
    last: bool = False,
) -> Streams:
    """Run one layer of one or both streams: attention over all tokens together, the rest per stream.

    Args:
        streams: prefix and suffix embeddings.
        layers: the VLM's and the expert's decoder layer at this depth.
        mask: (B, 1, L, L) additive, L = L0 + L1.
        rotary: (cos, sin), each (B, L, head_dim).
        cond: per stream, the time condition of its adaptive norms (B, D), or None.
        past: rotated keys and values (B, 1, L_past, head_dim) of tokens that came before, as cached.
        last: return the final stream only; after the last layer nobody reads the prefix.
    """
    normed = [
        layernorm_forward(la.input_layernorm, x, c) for la, x, c in zip(layers, streams, cond, strict=True)
    ]
    kept = slice(-1 if last else 0, None)
    lengths = [x.shape[1] for x in streams[kept]]
    attended = _attend([x for x, _ in normed], layers, mask, rotary, past, lengths)
    out = []
    rows = zip(layers[kept], streams[kept], normed[kept], attended, cond[kept], strict=True)
    for layer, x, (_, gate), a, c in rows:
        x = _gated_residual(x, layer.self_attn.o_proj(a), gate)
        hidden, gate = layernorm_forward(layer.post_attention_layernorm, x, c)
        out.append(_gated_residual(x, layer.mlp(hidden), gate))
    return out


def _attend(
    normed: Streams,
    layers: list[nn.Module],
    mask: Tensor,
    rotary: tuple,
    past: tuple[Tensor, Tensor] | None,
    lengths: list[int],
) -> list[Tensor]:
    """Let the last ``sum(lengths)`` tokens attend to all; return one (B, length, heads·head) per length."""
    q, k, v = (_project(normed, layers, n) for n in ("q_proj", "k_proj", "v_proj"))  # (B, heads, L, head)
    q, k = apply_rotary_pos_emb(q, k, *rotary, unsqueeze_dim=1)
    if past is not None:
        k, v = torch.cat([past[0], k], dim=2), torch.cat([past[1], v], dim=2)
    scale = layers[0].self_attn.scaling
    heads = q.shape[1]
    k, v = (x.expand(-1, heads, -1, -1) for x in (k, v))  # one key/value head serves all queries
    q, mask = q[:, :, -sum(lengths) :], mask[:, :, -sum(lengths) :]
    mixed = nn.functional.scaled_dot_product_attention(q, k, v, attn_mask=mask, scale=scale)
    mixed = mixed.transpose(1, 2).flatten(2)  # (B, L, heads·head)
    return list(mixed.split(lengths, dim=1))


def _project(normed: Streams, layers: list[nn.Module], name: str) -> Tensor:
    parts = []
    for layer, x in zip(layers, normed, strict=True):
        parts.append(getattr(layer.self_attn, name)(x).unflatten(-1, (-1, layer.self_attn.head_dim)))
    return torch.cat(parts, dim=1).transpose(1, 2)
