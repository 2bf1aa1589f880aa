"""What the fast sampler prepares once per weights: norms' modulation per flow step, fused projections, gains."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.fast_math import Modulation


@dataclass(frozen=True)
class StepTable:
    """What a flow step needs besides the actions: ``layers`` holds (before attention, before MLP) per layer."""

    layers: list[tuple[Modulation, Modulation]]
    last: Modulation


class Prepared:
    """Tables of one network; made anew when a weight changed since the last call.

    Attributes:
        eps: the norms' epsilon, one for all of π0.5, as a tensor.
        gains: of the VLM's norms, (before attention, before MLP) per layer.
        qkv: query, key and value weights of the expert's layers side by side, ((heads + 2)·head, D) each.
    """

    def __init__(self, network: stock.PI05Pytorch) -> None:
        self._network = network
        self._prepared_for: Any = None
        self._tables: dict[int, list[StepTable]] = {}
        self.version = 0  # counts preparations
        self.eps = torch.empty(0)
        self.gains: list[tuple[Tensor, Tensor]] = []
        self.qkv: list[Tensor] = []

    def tables(self, num_steps: int) -> list[StepTable]:
        """Return the step tables of these weights; made anew when a weight changed since the last call."""
        weights = tuple((p.data_ptr(), p._version) for p in self._prepared_parameters())
        if weights != self._prepared_for:
            self._prepared_for, self._tables = weights, {}
            self.version += 1
            vlm = self._network.paligemma_with_expert.paligemma.model.language_model
            self.eps = torch.full((), vlm.norm.eps, device=vlm.norm.weight.device)
            self.gains = [
                (1 + layer.input_layernorm.weight.float(), 1 + layer.post_attention_layernorm.weight.float())
                for layer in vlm.layers
            ]
            self.qkv = [
                _fuse(layer) for layer in self._network.paligemma_with_expert.gemma_expert.model.layers
            ]
        if num_steps not in self._tables:
            self._tables[num_steps] = self._step_tables(num_steps)
        return self._tables[num_steps]

    def current(self, num_steps: int) -> list[StepTable]:
        """Return the step tables made by the latest :meth:`tables`, without a look at the weights."""
        return self._tables[num_steps]

    def _prepared_parameters(self) -> list[Tensor]:
        network, joint = self._network, self._network.paligemma_with_expert
        norms = [
            norm.weight
            for layer in joint.paligemma.model.language_model.layers
            for norm in (layer.input_layernorm, layer.post_attention_layernorm)
        ]
        time = [*network.time_mlp_in.parameters(), *network.time_mlp_out.parameters()]
        return [*joint.gemma_expert.model.parameters(), *time, *norms]

    def _step_tables(self, num_steps: int) -> list[StepTable]:
        """Return the modulation of every norm at the times Euler's method visits: 1, 1 − 1/n, …, 1/n."""
        network, expert = self._network, self._network.paligemma_with_expert.gemma_expert.model
        device = network.action_in_proj.weight.device
        times = torch.tensor([1.0 - step / num_steps for step in range(num_steps)], device=device)
        width, config = network.action_in_proj.out_features, network.config
        wave = stock.create_sinusoidal_pos_embedding(
            times, width, config.min_period, config.max_period, device=device
        ).to(times.dtype)
        cond = F.silu(network.time_mlp_out(F.silu(network.time_mlp_in(wave))))  # (steps, D)
        dtype = expert.layers[0].self_attn.q_proj.weight.dtype
        before = [_modulation(layer.input_layernorm, cond, dtype) for layer in expert.layers]
        after = [_modulation(layer.post_attention_layernorm, cond, dtype) for layer in expert.layers]
        final = _modulation(expert.norm, cond, dtype)
        return [
            StepTable([(a[step], b[step]) for a, b in zip(before, after, strict=True)], final[step])
            for step in range(num_steps)
        ]


def _modulation(norm: nn.Module, cond: Tensor, dtype: torch.dtype) -> list[Modulation]:
    """Return a norm's modulation per step; gates in the network's own ``dtype``, as LeRobot casts them."""
    scale, shift, gate = norm.dense(cond).chunk(3, dim=-1)
    return [
        Modulation(1 + s.float(), h.float(), g.to(dtype)) for s, h, g in zip(scale, shift, gate, strict=True)
    ]


def _fuse(layer: nn.Module) -> Tensor:
    attention = layer.self_attn
    return torch.cat([attention.q_proj.weight, attention.k_proj.weight, attention.v_proj.weight])
