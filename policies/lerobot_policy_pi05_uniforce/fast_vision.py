"""Cameras through SigLIP and its projector, all in one batch: transformers' network, fewer and fused operations."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.onednn import linear, linear_gelu, linear_plus


def see(paligemma: nn.Module, images: Tensor) -> Tensor:
    """Return (cameras, patches, D) tokens of (cameras, 3, H, W) images in [−1, 1].

    Args:
        paligemma: PaliGemma's ``model``: vision tower and projector, in float32 as LeRobot keeps them.
        images: of the resolution the tower was built for.
    """
    tower = paligemma.vision_tower
    tower = getattr(tower, "vision_model", tower)  # transformers moved it: a wrapper or the tower itself
    x = tower.embeddings(images.float())
    for layer in tower.encoder.layers:
        x = _attention(layer.self_attn, _normed(layer.layer_norm1, x), x)
        x = _mlp(layer.mlp, _normed(layer.layer_norm2, x), x)
    head = paligemma.multi_modal_projector.linear
    return linear(_normed(tower.post_layernorm, x), head.weight, head.bias).to(images.dtype)


def _attention(a: nn.Module, x: Tensor, residual: Tensor) -> Tensor:
    parts = [linear(x, p.weight, p.bias) for p in (a.q_proj, a.k_proj, a.v_proj)]
    q, k, v = (part.unflatten(-1, (-1, a.head_dim)).transpose(1, 2) for part in parts)  # (B, heads, L, head)
    mixed = F.scaled_dot_product_attention(q, k, v, scale=a.scale).transpose(1, 2).flatten(2)
    return linear_plus(mixed, a.out_proj.weight, a.out_proj.bias, residual)


def _mlp(mlp: nn.Module, x: Tensor, residual: Tensor) -> Tensor:
    hidden = linear_gelu(x, mlp.fc1.weight, mlp.fc1.bias)
    return linear_plus(hidden, mlp.fc2.weight, mlp.fc2.bias, residual)


def _normed(norm: nn.LayerNorm, x: Tensor) -> Tensor:
    return F.layer_norm(x, norm.normalized_shape, norm.weight, norm.bias, norm.eps)
