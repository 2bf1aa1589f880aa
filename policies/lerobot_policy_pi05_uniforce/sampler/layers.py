"""Arithmetic of the fast sampler, and tensors that are prepared once per weights."""

import copy
from typing import Any, NamedTuple

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch

# cos, and sin with the sign rotate_half would give; (B, heads, L, head) each
Rotary = tuple[Tensor, Tensor]


class Modulation(NamedTuple):
    """One adaptive norm at one flow time: normed · scale + shift, and a gate; (D,) each."""

    scale: Tensor
    shift: Tensor
    gate: Tensor


# of one flow step: before attention and before MLP of each layer in turn, and the last norm's
StepTable = tuple[Modulation, ...]


def modulated(x: Tensor, by: Modulation, eps: Tensor) -> Tensor:
    """Return an adaptive norm of ``x`` (…, D), in ``x``'s own dtype."""
    return torch.addcmul(by.shift, rms(x, eps), by.scale).to(x.dtype)


def rms(x: Tensor, eps: Tensor) -> Tensor:
    """Return ``x`` over its RMS, in float32 as LeRobot computes it; ``eps`` is a 0-d tensor."""
    wide = x.float()
    norm = torch.linalg.vector_norm(wide, dim=-1, keepdim=True)
    return wide * torch.rsqrt(torch.addcmul(eps, norm, norm, value=1 / x.shape[-1]))


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


def rotated(rows: Tensor, rotary: Rotary, head: int) -> Tensor:
    """Return (B, L, (heads + 2)·head) rows by head, turned by their positions.

    x·cos + swap(x)·signed sin, swapped by rolling: (B, heads + 2, L, head).
    """
    cos, sin = rotary
    by_head = rows.unflatten(-1, (-1, head)).transpose(1, 2)
    return torch.addcmul(by_head * cos, by_head.roll(head // 2, dims=-1), sin)


def attend(q: Tensor, key_value: Tensor, mask: Tensor | None) -> Tensor:
    """Return (B, L, heads·head) of scaled queries (B, heads, L, head), by torch's fused attention.

    All heads share one key and value, (B, 2, L_k, head). The mask (B, 1, 1, L_k) is additive.
    """
    heads = q.shape[1]
    keys = key_value[:, :1].expand(-1, heads, -1, -1)
    values = key_value[:, 1:].expand(-1, heads, -1, -1)
    mixed = F.scaled_dot_product_attention(q, keys, values, attn_mask=mask, scale=1.0)
    return mixed.transpose(1, 2).flatten(2)


def attend_folded(q: Tensor, key_value: Tensor, mask: Tensor | None) -> Tensor:
    """Return what :func:`attend` does, by two products with the heads as further rows.

    For the few rows of a flow step, where fused attention has little to gain. The softmax is in
    float32.
    """
    keys, values = key_value.unbind(dim=1)  # (B, L_k, head)
    scores = (q.flatten(1, 2) @ keys.transpose(1, 2)).float()  # (B, heads·L, L_k)
    if mask is not None:
        scores = scores + mask[:, 0]
    mixed = scores.softmax(dim=-1).to(q.dtype) @ values  # (B, heads·L, head)
    return mixed.unflatten(1, q.shape[1:3]).transpose(1, 2).flatten(2)


class Prepared:
    """Tensors prepared once per weights; made anew when a weight changed since the last call."""

    def __init__(self, network: PI05UniforcePytorch) -> None:
        self._network = network
        self._prepared_for: Any = None
        self.version = 0  # counts preparations
        # where the weights are that anything is prepared from; modules stay, their weights may not
        self._read: list[dict[str, Tensor | None]] = []
        model = network.paligemma_with_expert.paligemma.model
        roots = [network.expert, network.time_mlp_in, network.time_mlp_out]
        roots += [model.vision_tower, model.multi_modal_projector]
        for layer in network.vlm.layers:
            roots += [layer.input_layernorm, layer.post_attention_layernorm]
        for root in roots:
            self._read += [module._parameters for module in root.modules()]

    def tables(self, num_steps: int) -> list[StepTable]:
        """Return the step tables of these weights, for a flow of so many steps."""
        weights = []
        for held in self._read:
            weights += [(p.data_ptr(), p._version) for p in held.values() if p is not None]
        if weights != self._prepared_for:
            self._prepared_for = weights
            self.version += 1
            self._prepare()
        if num_steps not in self._tables:
            self._tables[num_steps] = self._step_tables(num_steps)
        return self._tables[num_steps]

    def _prepare(self) -> None:
        vlm = self._network.vlm
        self.dtype = vlm.layers[0].self_attn.q_proj.weight.dtype
        self._tables: dict[int, list[StepTable]] = {}
        # of the norms, one for all of π0.5
        self.eps = torch.full((), vlm.norm.eps, device=vlm.norm.weight.device)
        # of the VLM's norms, before attention and before the MLP of each layer
        self.gains: list[tuple[Tensor, Tensor]] = []
        for layer in vlm.layers:
            before = 1 + layer.input_layernorm.weight.float()
            self.gains.append((before, 1 + layer.post_attention_layernorm.weight.float()))
        # of the expert's layers, side by side: ((heads + 2)·head, D) and (2·hidden, D) each
        self.qkv: list[Tensor] = []
        self.gate_up: list[Tensor] = []
        for layer in self._network.expert.layers:
            a = layer.self_attn
            self.qkv.append(torch.cat([a.q_proj.weight, a.k_proj.weight, a.v_proj.weight]))
            self.gate_up.append(torch.cat([layer.mlp.gate_proj.weight, layer.mlp.up_proj.weight]))
        # LeRobot keeps the cameras in float32, for its optimizer's sake; nothing is trained here
        model = self._network.paligemma_with_expert.paligemma.model
        eyes = nn.ModuleList([model.vision_tower, model.multi_modal_projector])
        if self.dtype != torch.float32:
            eyes = copy.deepcopy(eyes).to(self.dtype)
        self.tower, self.projector = eyes

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
        by_norm = [_modulation(norm, cond, self.dtype) for norm in (*norms, network.expert.norm)]
        return list(zip(*by_norm, strict=True))


def _modulation(norm: nn.Module, cond: Tensor, dtype: torch.dtype) -> list[Modulation]:
    """Return a norm's modulation per step; gates in the network's ``dtype``, as LeRobot's."""
    scale, shift, gate = norm.dense(cond).chunk(3, dim=-1)  # (steps, D) each
    return list(map(Modulation, 1 + scale.float(), shift.float(), gate.to(dtype)))
