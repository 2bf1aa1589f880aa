"""Sample an action chunk as LeRobot's π0.5 does, without what it computes twice or for nothing.

Same weights, same mathematics, another order of summation (equal within 1e-4 on actions; tests compare them). Left
out: cameras that are missing and text that is padding; the last VLM layer after its keys and values, which are not
read; copies of the prefix cache in every flow step; the norms' modulation, which depends on the flow time alone and is
kept in a table per step; attention matrices, by torch's fused attention; masks, positions and rotations built again.
"""

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
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


class FastSampler:
    """Samples for one ``network.PI05UniforcePytorch``; weights that changed since the last call are prepared again."""

    def __init__(self, network: stock.PI05Pytorch) -> None:
        self.network = network
        self.prepared = Prepared(network)
        self.encoder = PrefixEncoder(network, self.prepared)
        self.graphed: GraphedSampler | None = None  # made where there is a cuda device

    @torch.no_grad()
    def sample(self, inputs: Inputs, noise: Tensor, num_steps: int) -> Tensor:
        """Return (B, chunk, max_action_dim) actions."""
        tables, inputs = self.prepared.tables(num_steps), drop_dead(inputs)
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
        x, num_steps = noise, len(tables)
        for table in tables:
            x = torch.add(x, self.velocity(prefix, x, table), alpha=-1.0 / num_steps)
        return x

    def velocity(self, prefix: Prefix, actions: Tensor, table: StepTable) -> Tensor:
        """Return (B, chunk, max_action_dim) velocity of noisy ``actions`` at the table's flow time."""
        network, expert = self.network, self.network.paligemma_with_expert.gemma_expert.model
        eps = self.prepared.eps
        x = network.action_in_proj(actions)
        if prefix.touch is not None:
            x = torch.cat([prefix.touch.tokens.to(x.dtype), x], dim=1)  # (B, N + chunk, D)
        x = x.to(expert.layers[0].self_attn.q_proj.weight.dtype)
        for depth, layer in enumerate(expert.layers):
            attention, mlp = table.layers[depth]
            qkv = linear(modulated(x, attention, eps), self.prepared.qkv[depth])
            mixed = self._mix(prefix, depth, layer, qkv)
            x = torch.addcmul(x, linear(mixed, layer.self_attn.o_proj.weight), attention.gate)
            hidden = gated_hidden(layer.mlp, modulated(x, mlp, eps))
            x = torch.addcmul(x, linear(hidden, layer.mlp.down_proj.weight), mlp.gate)
        x = x[:, -actions.shape[1] :]
        return network.action_out_proj(modulated(x, table.last, eps).float())

    def _mix(self, prefix: Prefix, depth: int, layer: nn.Module, qkv: Tensor) -> Tensor:
        """Let the suffix attend to the prefix and to itself; its key and value take their places in the cache."""
        rows = qkv.unflatten(-1, (-1, layer.self_attn.head_dim))
        rows = rows.transpose(1, 2)  # (B, heads + 2, L_suffix, head)
        turned, cache = rotated(rows, prefix.rotary), prefix.prefill.cache[depth]
        length = prefix.prefill.pads.shape[1]
        cache[:, :, length:] = turned[:, -2:]
        return attend(turned[:, :-2], cache, prefix.mask)
