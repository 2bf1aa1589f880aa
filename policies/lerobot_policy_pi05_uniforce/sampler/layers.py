"""Arithmetic of the fast sampler, and what it prepares once per weights; without copies that LeRobot's layers make.

Products run in oneDNN where it takes them: torch sends a float32 ``linear`` on a CPU to MKL, which on AMD processors
runs at half of oneDNN's speed (docs/experiments/policy_speed.md). Results agree within rounding. Without oneDNN, on
another device, in another dtype, where a gradient is wanted, or where torch.compile traces, torch runs.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

AVAILABLE = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")
# of attention: fewer aren't worth five operations, more leave the cache, and torch's tiled attention wins
SCORES = (2**16, 2**20)
# cos, and sin with the sign rotate_half would give; (B, heads, L, head) each
Rotary = tuple[Tensor, Tensor]


class Modulation(NamedTuple):
    """One adaptive norm at one flow time: normed · scale + shift, and the gate of what follows; (D,) each."""

    scale: Tensor
    shift: Tensor
    gate: Tensor


def here(x: Tensor) -> bool:
    """Return whether oneDNN takes this tensor's products: float32 on a CPU, no gradient wanted, not compiling."""
    wanted = x.device.type == "cpu" and x.dtype == torch.float32 and not torch.is_grad_enabled()
    return AVAILABLE and wanted and not torch.compiler.is_compiling()


def linear(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Return ``x`` (…, K) times ``weight`` (N, K) transposed, plus ``bias`` (N,)."""
    if not here(x):
        return F.linear(x, weight, bias)
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "none", [], "")


def linear_gelu(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """Return the tanh GELU of :func:`linear`."""
    if not here(x):
        return F.gelu(F.linear(x, weight, bias), approximate="tanh")
    return torch.ops.mkldnn._linear_pointwise(x, weight, bias, "gelu", [], "tanh")


def linear_times(x: Tensor, weight: Tensor, factor: Tensor) -> Tensor:
    """Return :func:`linear` times ``factor`` (…, N)."""
    if not here(x):
        return F.linear(x, weight) * factor
    return torch.ops.mkldnn._linear_pointwise.binary(x, factor, weight, None, "mul")


def linear_plus(x: Tensor, weight: Tensor, bias: Tensor | None, summand: Tensor) -> Tensor:
    """Return :func:`linear` plus ``summand`` (…, N), a residual stream."""
    if not here(x):
        return F.linear(x, weight, bias) + summand
    return torch.ops.mkldnn._linear_pointwise.binary(x, summand, weight, bias, "add")


def gated_hidden(mlp: nn.Module, x: Tensor) -> Tensor:
    """Return the hidden layer of Gemma's MLP, gelu(gate) · up."""
    return linear_times(x, mlp.up_proj.weight, linear_gelu(x, mlp.gate_proj.weight))


def attend_one(q: Tensor, k: Tensor, v: Tensor, mask: Tensor | None) -> Tensor:
    """Return attention (1, heads, L, head) of a batch of one, all heads in one product.

    Args:
        q: (1, heads, L, head), scaled.
        k: (L_keys, head), shared by all heads, as ``v`` is.
        v: (L_keys, head).
        mask: (1, 1, 1 or L, L_keys), bool (True is seen) or additive, or None.
    """
    # of strided ones oneDNN makes products a thousand times slower
    k, v = k.contiguous(), v.contiguous()
    scores = linear(q.flatten(0, 2), k)  # (heads·L, L_keys)
    if mask is not None:
        apart = scores.view(*q.shape[:3], -1)
        apart.masked_fill_(~mask, -torch.inf) if mask.dtype == torch.bool else apart.add_(mask)
    return linear(scores.softmax(dim=-1), v.t()).view(q.shape)


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
    if (
        here(q)
        and len(q) == 1
        and SCORES[0] <= q.shape[1] * q.shape[2] * cache.shape[2] <= SCORES[1]
    ):
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
    # transformers moved it: a wrapper or the tower itself
    tower = getattr(tower, "vision_model", tower)
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
    # (B, heads, L, head)
    q, k, v = (part.unflatten(-1, (-1, a.head_dim)).transpose(1, 2) for part in parts)
    mixed = F.scaled_dot_product_attention(q, k, v, scale=a.scale).transpose(1, 2).flatten(2)
    return linear_plus(mixed, a.out_proj.weight, a.out_proj.bias, residual)


def _normed(norm: nn.LayerNorm, x: Tensor) -> Tensor:
    return F.layer_norm(x, norm.normalized_shape, norm.weight, norm.bias, norm.eps)


@dataclass(frozen=True)
class StepTable:
    """Modulations of one flow step: ``layers`` holds (before attention, before MLP) per layer."""

    layers: list[tuple[Modulation, Modulation]]
    last: Modulation


class Prepared:
    """Tensors prepared once per weights; made anew when a weight changed since the last call."""

    def __init__(self, network: stock.PI05Pytorch) -> None:
        self._network = network
        self._prepared_for: Any = None
        self._tables: dict[int, list[StepTable]] = {}
        self.version = 0  # counts preparations
        self.eps = torch.empty(0)  # of the norms, one for all of π0.5
        # of the VLM's norms, before attention and MLP, per layer
        self.gains: list[tuple[Tensor, Tensor]] = []
        # of the expert's layers, side by side, ((heads + 2)·head, D) each
        self.qkv: list[Tensor] = []

    def tables(self, num_steps: int) -> list[StepTable]:
        """Return the step tables of these weights, for a flow of so many steps."""
        weights = tuple((p.data_ptr(), p._version) for p in self._prepared_parameters())
        if weights != self._prepared_for:
            self._prepared_for, self._tables = weights, {}
            self.version += 1
            vlm = self._network.paligemma_with_expert.paligemma.model.language_model
            expert = self._network.paligemma_with_expert.gemma_expert.model
            self.eps = torch.full((), vlm.norm.eps, device=vlm.norm.weight.device)
            norms = [
                (la.input_layernorm.weight, la.post_attention_layernorm.weight) for la in vlm.layers
            ]
            self.gains = [(1 + first.float(), 1 + second.float()) for first, second in norms]
            heads = [
                (a.q_proj, a.k_proj, a.v_proj) for a in (layer.self_attn for layer in expert.layers)
            ]
            self.qkv = [torch.cat([part.weight for part in parts]) for parts in heads]
        if num_steps not in self._tables:
            self._tables[num_steps] = self._step_tables(num_steps)
        return self._tables[num_steps]

    def _prepared_parameters(self) -> list[Tensor]:
        network, joint = self._network, self._network.paligemma_with_expert
        layers = joint.paligemma.model.language_model.layers
        norms = [
            norm.weight
            for la in layers
            for norm in (la.input_layernorm, la.post_attention_layernorm)
        ]
        time = [*network.time_mlp_in.parameters(), *network.time_mlp_out.parameters()]
        return [*joint.gemma_expert.model.parameters(), *time, *norms]

    def _step_tables(self, num_steps: int) -> list[StepTable]:
        """Return the modulation of every norm at the times Euler's method visits: 1, 1 − 1/n, …, 1/n."""
        network, expert = self._network, self._network.paligemma_with_expert.gemma_expert.model
        device = network.action_in_proj.weight.device
        times = torch.tensor([1.0 - step / num_steps for step in range(num_steps)], device=device)
        width, config = network.action_in_proj.out_features, network.config
        periods = config.min_period, config.max_period
        wave = stock.create_sinusoidal_pos_embedding(times, width, *periods, device=device).to(
            times.dtype
        )
        cond = F.silu(network.time_mlp_out(F.silu(network.time_mlp_in(wave))))  # (steps, D)
        dtype = expert.layers[0].self_attn.q_proj.weight.dtype
        before = [_modulation(layer.input_layernorm, cond, dtype) for layer in expert.layers]
        after = [
            _modulation(layer.post_attention_layernorm, cond, dtype) for layer in expert.layers
        ]
        final = _modulation(expert.norm, cond, dtype)
        layers = [
            [(a[n], b[n]) for a, b in zip(before, after, strict=True)] for n in range(num_steps)
        ]
        return [StepTable(pairs, last) for pairs, last in zip(layers, final, strict=True)]


def _modulation(norm: nn.Module, cond: Tensor, dtype: torch.dtype) -> list[Modulation]:
    """Return a norm's modulation per step; gates in the network's own ``dtype``, as LeRobot casts them."""
    scale, shift, gate = norm.dense(cond).chunk(3, dim=-1)
    rows = zip(scale, shift, gate, strict=True)
    return [Modulation(1 + s.float(), h.float(), g.to(dtype)) for s, h, g in rows]
