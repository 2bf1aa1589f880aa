"""Sample an action chunk as LeRobot's π0.5 does, without what it computes twice or for nothing.

Same weights, same mathematics, another order of summation (equal within 1e-4 on actions; tests compare them). What is
left out: cameras that are missing and text that is padding; the last VLM layer after its keys and values, which nobody
reads; copies of the prefix cache in every flow step; the norms' modulation, which depends on the flow time alone and is
kept in a table per step; attention matrices, by torch's fused attention; masks, positions and rotations built again.
"""

from __future__ import annotations

from typing import Any

import torch
from lerobot.policies.common.flow_matching import euler_integrate
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.cuda_graphs import GraphedSampler
from lerobot_policy_pi05_uniforce.fast_math import attend, modulated, rotated
from lerobot_policy_pi05_uniforce.fast_prefix import Prefix, PrefixEncoder, drop_dead
from lerobot_policy_pi05_uniforce.force_tokens import SuffixTouch
from lerobot_policy_pi05_uniforce.onednn import gated_hidden, linear
from lerobot_policy_pi05_uniforce.step_tables import Prepared, StepTable
from uniforce_vtla.errors import ContractError, expected


class FastSampler:
    """Samples for one ``network.PI05UniforcePytorch``; weights that changed since the last call are prepared again."""

    def __init__(self, network: stock.PI05Pytorch) -> None:
        groups = network.paligemma_with_expert.gemma_expert.config.num_key_value_heads
        if groups != 1:
            do = "Use sampler=stock."
            raise ContractError(expected("key/value heads of the expert", 1, groups, do))
        self.network = network
        self.latest: Prefix | None = None  # of the last sample, for ``refresh``
        self.prepared = Prepared(network)
        self.encoder = PrefixEncoder(network, self.prepared)
        self.graphed: GraphedSampler | None = None  # replays CUDA graphs; cuda devices only

    @torch.no_grad()
    def sample(
        self,
        images: list,
        img_masks: list,
        tokens: Tensor,
        masks: Tensor,
        noise: Tensor,
        num_steps: int,
        **rtc: Any,
    ) -> Tensor:
        """Return (B, chunk, max_action_dim) actions; arguments as ``PI05Pytorch.sample_actions``."""
        tables = self.prepared.tables(num_steps)
        rtc_wanted = self.network._rtc_enabled() or self.network.rtc_processor is not None
        graphed = self._graphs(noise)
        if graphed is not None and not rtc_wanted:
            return graphed.sample(images, img_masks, tokens, masks, noise, num_steps)
        prefix = self.encoder.encode(*drop_dead(images, img_masks, tokens, masks), noise.shape[1])
        if rtc_wanted:
            return self._with_rtc(prefix, noise, tables, rtc)
        self.latest = prefix
        return self.flow(prefix, noise, tables)

    @torch.no_grad()
    def refresh(self, touch: SuffixTouch, noise: Tensor, num_steps: int) -> Tensor:
        """Return a chunk for what is felt now and what was seen at the last ``sample``.

        Raises:
            ContractError: nothing was sampled before, or the touch isn't in the suffix.
        """
        tables = self.prepared.tables(num_steps)
        chunk = None if self.graphed is None else self.graphed.refresh(touch, noise)
        if chunk is not None:
            return chunk
        if self.latest is None:
            raise ContractError(expected("refresh", "a sample before it", "none", "Call sample first."))
        self.latest = self.encoder.refreshed(self.latest, touch, noise.shape[1])
        return self.flow(self.latest, noise, tables)

    def _graphs(self, noise: Tensor) -> GraphedSampler | None:
        if self.graphed is None and noise.device.type == "cuda" and self.network.config.cuda_graphs:
            self.graphed = GraphedSampler(self)
        return self.graphed

    def flow(self, prefix: Prefix, noise: Tensor, tables: list[StepTable]) -> Tensor:
        """Return the actions at the end of the flow from ``noise``, by Euler's method."""
        x, num_steps = noise, len(tables)
        for table in tables:
            x = torch.add(x, self.velocity(prefix, x, table), alpha=-1.0 / num_steps)
        return x

    def _with_rtc(
        self, prefix: Prefix, noise: Tensor, tables: list[StepTable], rtc: dict[str, Any]
    ) -> Tensor:
        num_steps = len(tables)
        return euler_integrate(
            lambda x, time: self.velocity(prefix, x, tables[round((1 - float(time[0])) * num_steps)]),
            noise,
            num_steps,
            rtc_processor=self.network.rtc_processor,
            rtc_enabled=self.network._rtc_enabled(),
            inference_delay=rtc.get("inference_delay"),
            prev_chunk_left_over=rtc.get("prev_chunk_left_over"),
            execution_horizon=rtc.get("execution_horizon"),
        )

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
        turned, cache = rotated(rows, prefix.rotary), prefix.cache[depth]
        if torch.is_grad_enabled():  # RTC's guidance differentiates through here: nothing may be overwritten
            cache = torch.cat([cache[:, :, : prefix.length], turned[:, -2:]], dim=2)
        else:
            cache[:, :, prefix.length :] = turned[:, -2:]
        return attend(turned[:, :-2], cache, prefix.mask)
