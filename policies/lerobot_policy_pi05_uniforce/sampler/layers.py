"""Arithmetic of the fast sampler, without LeRobot's copies, and tensors prepared once per weights.

Products run in oneDNN where it takes them: torch sends a float32 ``linear`` on a CPU to MKL, which
on AMD processors has half of oneDNN's speed (docs/experiments/policy_speed.md). Results agree
within rounding. Without oneDNN, on another device, in another dtype, where a gradient is wanted, or
where torch.compile traces, torch runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch

AVAILABLE = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_linear_pointwise")
# of attention: fewer aren't worth five operations, more leave the cache: torch's is faster
SCORES = (2**16, 2**20)
# cos, and sin with the sign rotate_half would give; (B, heads, L, head) each
Rotary = tuple[Tensor, Tensor]


class Modulation(NamedTuple):
    """One adaptive norm at one flow time: normed · scale + shift, and a gate; (D,) each."""

    scale: Tensor
    shift: Tensor
    gate: Tensor


# of one flow step: before attention and before MLP of each layer in turn, and the last norm's
StepTable = tuple[Modulation, ...]


def here(x: Tensor) -> bool:
    """Return whether oneDNN takes this tensor's products: float32, CPU, no gradient, no tracing."""
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
        if mask.dtype == torch.bool:
            apart.masked_fill_(~mask, -torch.inf)
        else:
            apart.add_(mask)
    return linear(scores.softmax(dim=-1), v.t()).view(q.shape)


def modulated(x: Tensor, by: Modulation, eps: Tensor) -> Tensor:
    """Return an adaptive norm of ``x`` (…, D), in ``x``'s own dtype."""
    return torch.addcmul(by.shift, rms(x, eps), by.scale).to(x.dtype)


def rms(x: Tensor, eps: Tensor) -> Tensor:
    """Return ``x`` over its RMS, in float32 as LeRobot computes it; ``eps`` is a 0-d tensor."""
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
    """Return cos and signed sin for (B, heads + 2, L, head) rows: queries, key, value.

    Queries are also scaled; the value is left as it is.
    """
    cos, sin = model.rotary_emb(x, positions)  # (B, L, head)
    half = cos.shape[-1] // 2
    sin = torch.cat([-sin[..., :half], sin[..., half:]], dim=-1)
    heads = model.config.num_attention_heads
    turn = torch.stack([cos, sin])[:, :, None]  # (2, B, 1, L, head)
    still = torch.stack([torch.ones_like(cos), torch.zeros_like(sin)])[:, :, None]
    queries = (turn * model.layers[0].self_attn.scaling).expand(-1, -1, heads, -1, -1)
    cos, sin = torch.cat([queries, turn, still], dim=2).unbind()
    return cos, sin


def rotated(rows: Tensor, rotary: Rotary) -> Tensor:
    """Return rows turned by their positions: x·cos + swap(x)·signed sin, swapped by rolling."""
    cos, sin = rotary
    return torch.addcmul(rows * cos, rows.roll(rows.shape[-1] // 2, dims=-1), sin)


def attend(q: Tensor, cache: Tensor, mask: Tensor | None) -> Tensor:
    """Return (B, L, heads·head) of scaled queries (B, heads, L, head); all share one key/value."""
    heads = q.shape[1]
    scores = heads * q.shape[2] * cache.shape[2]
    if here(q) and len(q) == 1 and SCORES[0] <= scores <= SCORES[1]:
        mixed = attend_one(q, cache[0, 0], cache[0, 1], mask)
    else:
        keys = cache[:, :1].expand(-1, heads, -1, -1)
        values = cache[:, 1:].expand(-1, heads, -1, -1)
        mixed = F.scaled_dot_product_attention(q, keys, values, attn_mask=mask, scale=1.0)
    return mixed.transpose(1, 2).flatten(2)


def embed_cameras(paligemma: nn.Module, images: Tensor) -> Tensor:
    """Return (cameras, patches, D) tokens of (cameras, 3, H, W) images in [−1, 1].

    Args:
        paligemma: PaliGemma's ``model``: vision tower and projector, in float32 as LeRobot's.
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
    rows = []
    for part in (a.q_proj, a.k_proj, a.v_proj):
        row = linear(x, part.weight, part.bias).unflatten(-1, (-1, a.head_dim))
        rows.append(row.transpose(1, 2))  # (B, heads, L, head)
    q, k, v = rows
    mixed = F.scaled_dot_product_attention(q, k, v, scale=a.scale).transpose(1, 2).flatten(2)
    return linear_plus(mixed, a.out_proj.weight, a.out_proj.bias, residual)


def _normed(norm: nn.LayerNorm, x: Tensor) -> Tensor:
    return F.layer_norm(x, norm.normalized_shape, norm.weight, norm.bias, norm.eps)


class Prepared:
    """Tensors prepared once per weights; made anew when a weight changed since the last call."""

    def __init__(self, network: PI05UniforcePytorch) -> None:
        self._network = network
        self._prepared_for: Any = None
        self.version = 0  # counts preparations

    def tables(self, num_steps: int) -> list[StepTable]:
        """Return the step tables of these weights, for a flow of so many steps."""
        weights = [(p.data_ptr(), p._version) for p in self._weights()]
        if weights != self._prepared_for:
            self._prepared_for = weights
            self.version += 1
            self._prepare()
        if num_steps not in self._tables:
            self._tables[num_steps] = self._step_tables(num_steps)
        return self._tables[num_steps]

    def _weights(self) -> Iterator[Tensor]:
        """Yield every weight that anything is prepared from."""
        yield from self._network.expert.parameters()
        yield from self._network.time_mlp_in.parameters()
        yield from self._network.time_mlp_out.parameters()
        for layer in self._network.vlm.layers:
            yield layer.input_layernorm.weight
            yield layer.post_attention_layernorm.weight

    def _prepare(self) -> None:
        vlm = self._network.vlm
        self._tables: dict[int, list[StepTable]] = {}
        # of the norms, one for all of π0.5
        self.eps = torch.full((), vlm.norm.eps, device=vlm.norm.weight.device)
        # of the VLM's norms, before attention and before the MLP of each layer
        self.gains: list[tuple[Tensor, Tensor]] = []
        for layer in vlm.layers:
            before = 1 + layer.input_layernorm.weight.float()
            self.gains.append((before, 1 + layer.post_attention_layernorm.weight.float()))
        # of the expert's layers, side by side, ((heads + 2)·head, D) each
        self.qkv: list[Tensor] = []
        for layer in self._network.expert.layers:
            a = layer.self_attn
            self.qkv.append(torch.cat([a.q_proj.weight, a.k_proj.weight, a.v_proj.weight]))

    def _step_tables(self, num_steps: int) -> list[StepTable]:
        """Return every norm's modulation at the times Euler's method visits: 1, 1 − 1/n, …, 1/n."""
        network = self._network
        weight = network.action_in_proj.weight  # (D, max_action_dim)
        visited = [1.0 - step / num_steps for step in range(num_steps)]
        times = torch.tensor(visited, device=weight.device)
        periods = network.config.min_period, network.config.max_period
        wave = stock.create_sinusoidal_pos_embedding(
            times, len(weight), *periods, device=weight.device
        )
        hidden = F.silu(network.time_mlp_in(wave.to(times.dtype)))
        cond = F.silu(network.time_mlp_out(hidden))  # (steps, D)
        norms = []
        for layer in network.expert.layers:
            norms += [layer.input_layernorm, layer.post_attention_layernorm]
        dtype = network.expert.layers[0].self_attn.q_proj.weight.dtype
        by_norm = [_modulation(norm, cond, dtype) for norm in (*norms, network.expert.norm)]
        return list(zip(*by_norm, strict=True))


def _modulation(norm: nn.Module, cond: Tensor, dtype: torch.dtype) -> list[Modulation]:
    """Return a norm's modulation per step; gates in the network's ``dtype``, as LeRobot's."""
    scale, shift, gate = norm.dense(cond).chunk(3, dim=-1)  # (steps, D) each
    return list(map(Modulation, 1 + scale.float(), shift.float(), gate.to(dtype)))
