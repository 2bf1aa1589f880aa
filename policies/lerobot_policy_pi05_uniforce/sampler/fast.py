"""Sample an action chunk as LeRobot's π0.5 does, without repeated or unread work.

Same weights and mathematics, another order of summation: actions are equal within 1e-4. Left out:

- cameras that are missing and text that is padding;
- the last VLM layer after its keys and values;
- copies of the prefix cache in every flow step;
- the norms' modulation, which depends on the flow time alone: it is kept in a table per step;
- attention matrices, by torch's fused attention;
- masks, positions and rotations, built once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.sampler.cuda_graphs import GraphedSampler
from lerobot_policy_pi05_uniforce.sampler.layers import (
    Prepared,
    StepTable,
    attend,
    gated_hidden,
    linear,
    modulated,
    rotated,
)
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs, Prefix, PrefixEncoder, drop_dead

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch


class FastSampler:
    """Samples for one network; weights that changed since the last call are prepared again."""

    def __init__(self, network: PI05UniforcePytorch) -> None:
        self.network = network
        self.prepared = Prepared(network)
        self.encoder = PrefixEncoder(network, self.prepared)
        self.graphed: GraphedSampler | None = None  # made where there is a cuda device

    @torch.no_grad()
    def sample(self, inputs: Inputs, noise: Tensor, num_steps: int) -> Tensor:
        """Return (B, chunk, max_action_dim) actions."""
        tables = self.prepared.tables(num_steps)
        inputs = drop_dead(inputs)
        graphed = self._graphs(noise)
        if graphed is not None:
            return graphed.sample(inputs, noise, tables)
        return self.flow(self.encoder.encode(inputs, noise.shape[1]), noise, tables)

    def _graphs(self, noise: Tensor) -> GraphedSampler | None:
        wanted = noise.device.type == "cuda" and self.network.config.sampler.kind == "fast"
        if self.graphed is None and wanted:
            self.graphed = GraphedSampler(self)
        return self.graphed

    def flow(self, prefix: Prefix, noise: Tensor, tables: list[StepTable]) -> Tensor:
        """Return the actions at the end of the flow from ``noise``, by Euler's method."""
        x = noise
        for table in tables:
            x = torch.add(x, self.velocity(prefix, x, table), alpha=-1.0 / len(tables))
        return x

    def velocity(self, prefix: Prefix, actions: Tensor, table: StepTable) -> Tensor:
        """Return (B, chunk, max_action_dim) velocity of noisy actions at a table's flow time."""
        expert = self.network.expert
        eps = self.prepared.eps
        x = self.network.action_in_proj(actions)
        x = x.to(expert.layers[0].self_attn.q_proj.weight.dtype)
        for depth, layer in enumerate(expert.layers):
            attention = table[2 * depth]
            mlp = table[2 * depth + 1]
            qkv = linear(modulated(x, attention, eps), self.prepared.qkv[depth])
            mixed = self._mix(prefix, depth, layer, qkv)
            x = torch.addcmul(x, linear(mixed, layer.self_attn.o_proj.weight), attention.gate)
            hidden = gated_hidden(layer.mlp, modulated(x, mlp, eps))
            x = torch.addcmul(x, linear(hidden, layer.mlp.down_proj.weight), mlp.gate)
        return self.network.action_out_proj(modulated(x, table[-1], eps).float())

    def _mix(self, prefix: Prefix, depth: int, layer: nn.Module, qkv: Tensor) -> Tensor:
        """Let the suffix attend to prefix and suffix; its key and value take their cache places."""
        rows = qkv.unflatten(-1, (-1, layer.self_attn.head_dim))
        turned = rotated(rows.transpose(1, 2), prefix.rotary)  # (B, heads + 2, L_suffix, head)
        cache = prefix.prefill.cache[depth]
        cache[:, :, prefix.prefill.real.shape[1] :] = turned[:, -2:]
        return attend(turned[:, :-2], cache, prefix.mask)
