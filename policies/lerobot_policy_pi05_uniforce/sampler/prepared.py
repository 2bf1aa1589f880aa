"""What the sampler prepares once per weights: step tables, gains of norms, projections side by side."""

from dataclasses import dataclass
from typing import Any

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.sampler.layers import Modulation


@dataclass(frozen=True)
class StepTable:
    """What a flow step needs besides the actions: ``layers`` holds (before attention, before MLP) per layer."""

    layers: list[tuple[Modulation, Modulation]]
    last: Modulation


class Prepared:
    """What is prepared once per weights; made anew when a weight changed since the last call."""

    def __init__(self, network: stock.PI05Pytorch) -> None:
        self._network = network
        self._prepared_for: Any = None
        self._tables: dict[int, list[StepTable]] = {}
        self.version = 0  # counts preparations
        self.eps = torch.empty(0)  # of the norms, one for all of π0.5
        # of the VLM's norms, before attention and MLP, per layer
        self.gains: list[tuple[Tensor, Tensor]] = []
        self.qkv: list[Tensor] = []  # of the expert's layers, side by side, ((heads + 2)·head, D) each

    def tables(self, num_steps: int) -> list[StepTable]:
        """Return the step tables of these weights, for a flow of so many steps."""
        weights = tuple((p.data_ptr(), p._version) for p in self._prepared_parameters())
        if weights != self._prepared_for:
            self._prepared_for, self._tables = weights, {}
            self.version += 1
            vlm = self._network.paligemma_with_expert.paligemma.model.language_model
            expert = self._network.paligemma_with_expert.gemma_expert.model
            self.eps = torch.full((), vlm.norm.eps, device=vlm.norm.weight.device)
            norms = [(la.input_layernorm.weight, la.post_attention_layernorm.weight) for la in vlm.layers]
            self.gains = [(1 + first.float(), 1 + second.float()) for first, second in norms]
            heads = [(a.q_proj, a.k_proj, a.v_proj) for a in (layer.self_attn for layer in expert.layers)]
            self.qkv = [torch.cat([part.weight for part in parts]) for parts in heads]
        if num_steps not in self._tables:
            self._tables[num_steps] = self._step_tables(num_steps)
        return self._tables[num_steps]

    def _prepared_parameters(self) -> list[Tensor]:
        network, joint = self._network, self._network.paligemma_with_expert
        layers = joint.paligemma.model.language_model.layers
        norms = [norm.weight for la in layers for norm in (la.input_layernorm, la.post_attention_layernorm)]
        time = [*network.time_mlp_in.parameters(), *network.time_mlp_out.parameters()]
        return [*joint.gemma_expert.model.parameters(), *time, *norms]

    def _step_tables(self, num_steps: int) -> list[StepTable]:
        """Return the modulation of every norm at the times Euler's method visits: 1, 1 − 1/n, …, 1/n."""
        network, expert = self._network, self._network.paligemma_with_expert.gemma_expert.model
        device = network.action_in_proj.weight.device
        times = torch.tensor([1.0 - step / num_steps for step in range(num_steps)], device=device)
        width, config = network.action_in_proj.out_features, network.config
        periods = config.min_period, config.max_period
        wave = stock.create_sinusoidal_pos_embedding(times, width, *periods, device=device).to(times.dtype)
        cond = F.silu(network.time_mlp_out(F.silu(network.time_mlp_in(wave))))  # (steps, D)
        dtype = expert.layers[0].self_attn.q_proj.weight.dtype
        before = [_modulation(layer.input_layernorm, cond, dtype) for layer in expert.layers]
        after = [_modulation(layer.post_attention_layernorm, cond, dtype) for layer in expert.layers]
        final = _modulation(expert.norm, cond, dtype)
        layers = [[(a[n], b[n]) for a, b in zip(before, after, strict=True)] for n in range(num_steps)]
        return [StepTable(pairs, last) for pairs, last in zip(layers, final, strict=True)]


def _modulation(norm: nn.Module, cond: Tensor, dtype: torch.dtype) -> list[Modulation]:
    """Return a norm's modulation per step; gates in the network's own ``dtype``, as LeRobot casts them."""
    scale, shift, gate = norm.dense(cond).chunk(3, dim=-1)
    rows = zip(scale, shift, gate, strict=True)
    return [Modulation(1 + s.float(), h.float(), g.to(dtype)) for s, h, g in rows]
