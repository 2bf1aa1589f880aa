"""Sample an action chunk as LeRobot's π0.5 does, without what it computes twice or for nothing.

Same weights, same mathematics, another order of summation (equal within 1e-4 on actions; tests compare them). What is
left out: cameras that are missing and text that is padding; the last VLM layer after its keys and values, which nobody
reads; copies of the prefix cache in every flow step; the norms' modulation, which depends on the flow time alone and is
kept in a table per step; attention matrices, by torch's fused attention; masks, positions and rotations built again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from lerobot.policies.common.flow_matching import euler_integrate
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from lerobot_policy_pi05_uniforce.force_tokens import SuffixTouch
from uniforce_vtla.errors import ContractError, expected

Cache = list[Tensor]  # per layer (B, 2, L_prefix + L_suffix, head): key and value
Rotary = tuple[Tensor, Tensor]  # cos, and sin with the sign rotate_half would give; (B, heads, L, head) each


class Modulation(NamedTuple):
    """One adaptive norm at one flow time: normed · scale + shift, and the gate of what follows; (D,) each."""

    scale: Tensor
    shift: Tensor
    gate: Tensor


@dataclass(frozen=True)
class StepTable:
    """What a flow step needs besides the actions: ``layers`` holds (before attention, before MLP) per layer."""

    layers: list[tuple[Modulation, Modulation]]
    last: Modulation


@dataclass(frozen=True)
class FusedLayer:
    """Weights of an expert layer side by side, so that one product gives what three or two did."""

    qkv: Tensor  # ((heads + 2)·head, D)
    gate_up: Tensor  # (2·mlp, D)


@dataclass(frozen=True)
class Prefix:
    """Cameras, text and extra tokens after the VLM: cache with room for the suffix, and how it may be looked at.

    Attributes:
        cache: keys and values, the suffix's places still empty.
        pads: (B, L_prefix) bool, which kept tokens are real.
        touch: force tokens in front of the actions, or None.
        mask: (B, 1, 1 or L_suffix, L_prefix + L_suffix) bool, or None where everyone may look at everything.
        rotary: of the suffix's positions, for queries, key and value; the value's turns nothing.
    """

    cache: Cache
    pads: Tensor
    touch: SuffixTouch | None
    mask: Tensor | None
    rotary: Rotary

    @property
    def length(self) -> int:
        """L_prefix, tokens kept."""
        return self.pads.shape[1]


class FastSampler:
    """Samples for one ``network.PI05UniforcePytorch``; weights that changed since the last call are prepared again."""

    def __init__(self, network: stock.PI05Pytorch) -> None:
        groups = network.paligemma_with_expert.gemma_expert.config.num_key_value_heads
        if groups != 1:
            do = "Use sampler=stock."
            raise ContractError(expected("key/value heads of the expert", 1, groups, do))
        self._network = network
        self.latest: Prefix | None = None  # of the last sample, for ``refresh``
        self._prepared_for: Any = None
        self._fused: list[FusedLayer] = []
        self._eps = torch.empty(0)  # the norms' epsilon, one for all of π0.5
        self._gains: list[tuple[Tensor, Tensor]] = []  # of the VLM's norms, per layer
        self._tables: dict[int, list[StepTable]] = {}

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
        tables = self.tables(num_steps)
        prefix = self.encode_prefix(*drop_dead(images, img_masks, tokens, masks), noise.shape[1])
        if self._network._rtc_enabled() or self._network.rtc_processor is not None:
            return self._with_rtc(prefix, noise, tables, rtc)
        self.latest = prefix
        return self._flow(prefix, noise, tables)

    @torch.no_grad()
    def refresh(self, touch: SuffixTouch, noise: Tensor, num_steps: int) -> Tensor:
        """Return a chunk for what is felt now and what was seen at the last ``sample``.

        Raises:
            ContractError: nothing was sampled before, or the touch isn't in the suffix.
        """
        if self.latest is None:
            raise ContractError(expected("refresh", "a sample before it", "none", "Call sample first."))
        self.latest = self.refreshed(self.latest, touch, noise.shape[1])
        return self._flow(self.latest, noise, self.tables(num_steps))

    def _flow(self, prefix: Prefix, noise: Tensor, tables: list[StepTable]) -> Tensor:
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
            rtc_processor=self._network.rtc_processor,
            rtc_enabled=self._network._rtc_enabled(),
            inference_delay=rtc.get("inference_delay"),
            prev_chunk_left_over=rtc.get("prev_chunk_left_over"),
            execution_horizon=rtc.get("execution_horizon"),
        )

    # -- once per observation ---------------------------------------------------------------------------

    def encode_prefix(
        self, images: list, img_masks: list, tokens: Tensor, masks: Tensor, chunk: int
    ) -> Prefix:
        """Run cameras, text and extra tokens through the VLM once and keep keys and values of every layer."""
        joint = self._network.paligemma_with_expert
        vlm = joint.paligemma.model.language_model
        x, pads = self._embed(images, img_masks, tokens, masks)
        x = x.to(vlm.layers[0].self_attn.q_proj.weight.dtype)
        mask = None if bool(pads.all()) else pads[:, None, None, :]  # what a padded token sees, nobody reads
        touch = self._network.suffix_touch(*_extra(images, img_masks))
        room = chunk + (0 if touch is None else touch.mask.shape[1])
        rotary = _rotary(vlm, x, pads.cumsum(dim=1) - 1)
        cache: Cache = []
        for depth, layer in enumerate(vlm.layers):
            rows = _project(layer, _rms(x, self._eps).mul_(self._gains[depth][0]))
            turned = _rotated(rows, rotary)
            cache.append(F.pad(turned[:, -2:], (0, 0, 0, room)))
            if depth == len(vlm.layers) - 1:
                break  # nobody reads what the last layer makes of the prefix
            mixed = _attend(turned[:, :-2], turned[:, -2:], mask, layer)
            x = layer.self_attn.o_proj(mixed).add_(x)  # in place: fresh memory costs more than the sum
            x = _mlp(layer.mlp, _rms(x, self._eps).mul_(self._gains[depth][1]).to(x.dtype)).add_(x)
        return self._looked_at(cache, pads, touch, chunk)

    def refreshed(self, prefix: Prefix, touch: SuffixTouch, chunk: int) -> Prefix:
        """Return the same cameras and text with what is felt now: nothing of the VLM runs again.

        Raises:
            ContractError: a network whose touch is not in the suffix.
        """
        if prefix.touch is None or prefix.touch.tokens.shape != touch.tokens.shape:
            came = None if prefix.touch is None else tuple(prefix.touch.tokens.shape)
            do = "Refreshing needs token_site=suffix and the slots the prefix was made with."
            raise ContractError(expected("touch of the prefix", tuple(touch.tokens.shape), came, do))
        return self._looked_at(prefix.cache, prefix.pads, touch, chunk)

    def _looked_at(self, cache: Cache, pads: Tensor, touch: SuffixTouch | None, chunk: int) -> Prefix:
        expert = self._network.paligemma_with_expert.gemma_expert.model
        behind = pads.new_ones(len(pads), chunk)
        if touch is not None:
            behind = torch.cat([touch.mask, behind], dim=1)  # (B, L_suffix)
        after = pads.sum(dim=1, keepdim=True) + behind.cumsum(dim=1) - 1
        columns = torch.cat([pads, behind], dim=1)[:, None, None, :]  # (B, 1, 1, L_prefix + L_suffix)
        mask = None if bool(columns.all()) and touch is None else columns
        if touch is not None:  # touch looks at the prefix and itself, actions at everything
            rows = torch.ones(behind.shape[1], columns.shape[-1], dtype=torch.bool, device=pads.device)
            rows[: touch.mask.shape[1], -chunk:] = False
            mask = columns & rows
        return Prefix(cache, pads, touch, mask, _rotary(expert, cache[0], after))

    def _embed(self, images: list, img_masks: list, tokens: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Return (B, L, D) tokens in LeRobot's order and (B, L) whether each is real; cameras go in one batch."""
        model = self._network.paligemma_with_expert
        cameras = [image for image in images if image.ndim == 4]
        parts: list[Tensor] = []
        if cameras:
            parts += model.embed_image(torch.cat(cameras)).chunk(len(cameras))
        pads = [mask[:, None].expand(-1, part.shape[1]) for part, mask in zip(parts, img_masks, strict=False)]
        parts.append(model.embed_language_tokens(tokens))
        pads.append(masks.bool())
        for part, mask in self._network.prefix_extra(*_extra(images, img_masks)):
            parts.append(part.to(parts[0].dtype))
            pads.append(mask[:, None].expand(-1, part.shape[1]))
        return torch.cat(parts, dim=1), torch.cat(pads, dim=1)

    # -- once per flow step -----------------------------------------------------------------------------

    def velocity(self, prefix: Prefix, actions: Tensor, table: StepTable) -> Tensor:
        """Return (B, chunk, max_action_dim) velocity of noisy ``actions`` at the table's flow time."""
        network, expert = self._network, self._network.paligemma_with_expert.gemma_expert.model
        x = network.action_in_proj(actions)
        if prefix.touch is not None:
            x = torch.cat([prefix.touch.tokens.to(x.dtype), x], dim=1)  # (B, N + chunk, D)
        x = x.to(expert.layers[0].self_attn.q_proj.weight.dtype)
        for depth, layer in enumerate(expert.layers):
            attention, mlp = table.layers[depth]
            fused = self._fused[depth]
            mixed = self._mix(prefix, depth, layer, F.linear(_modulated(x, attention, self._eps), fused.qkv))
            x = torch.addcmul(x, layer.self_attn.o_proj(mixed), attention.gate)
            gate, up = F.linear(_modulated(x, mlp, self._eps), fused.gate_up).chunk(2, dim=-1)
            x = torch.addcmul(x, layer.mlp.down_proj(layer.mlp.act_fn(gate) * up), mlp.gate)
        x = x[:, -actions.shape[1] :]
        return network.action_out_proj(_modulated(x, table.last, self._eps).float())

    def _mix(self, prefix: Prefix, depth: int, layer: nn.Module, qkv: Tensor) -> Tensor:
        """Let the suffix attend to the prefix and to itself; its key and value take their places in the cache."""
        rows = qkv.unflatten(-1, (-1, layer.self_attn.head_dim)).transpose(
            1, 2
        )  # (B, heads + 2, L_suffix, head)
        turned, cache = _rotated(rows, prefix.rotary), prefix.cache[depth]
        if torch.is_grad_enabled():  # RTC's guidance differentiates through here: nothing may be overwritten
            cache = torch.cat([cache[:, :, : prefix.length], turned[:, -2:]], dim=2)
        else:
            cache[:, :, prefix.length :] = turned[:, -2:]
        return _attend(turned[:, :-2], cache, prefix.mask, layer)

    # -- once per weights -------------------------------------------------------------------------------

    def tables(self, num_steps: int) -> list[StepTable]:
        """Return the step tables of these weights; made anew when a weight changed since the last call."""
        weights = tuple((p.data_ptr(), p._version) for p in self._prepared_parameters())
        if weights != self._prepared_for:
            self._prepared_for, self._tables = weights, {}
            vlm = self._network.paligemma_with_expert.paligemma.model.language_model
            self._eps = torch.full((), vlm.norm.eps, device=vlm.norm.weight.device)
            self._gains = [
                (1 + layer.input_layernorm.weight.float(), 1 + layer.post_attention_layernorm.weight.float())
                for layer in vlm.layers
            ]
            self._fused = [
                _fuse(layer) for layer in self._network.paligemma_with_expert.gemma_expert.model.layers
            ]
        if num_steps not in self._tables:
            self._tables[num_steps] = self._step_tables(num_steps)
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


def drop_dead(
    images: list, img_masks: list, tokens: Tensor, masks: Tensor
) -> tuple[list, list, Tensor, Tensor]:
    """Leave out inputs no row of the batch has, and text columns no prompt of the batch uses.

    Positions count real tokens only, and masked ones are looked at by nobody, so nothing else changes. Extra tokens
    (state, touch) stay in their places: which slot one belongs to is its place in the list.
    """
    kept = [(i, m) for i, m in zip(images, img_masks, strict=True) if i.ndim != 4 or bool(m.any())]
    used = int(masks.any(dim=0).nonzero().max()) + 1 if bool(masks.any()) else 0
    return [i for i, _ in kept], [m for _, m in kept], tokens[:, :used], masks[:, :used]


def _extra(images: list, img_masks: list) -> tuple[list, list]:
    """Return what rides behind the cameras, and its masks."""
    cameras = sum(image.ndim == 4 for image in images)
    return images[cameras:], img_masks[cameras:]


def _modulation(norm: nn.Module, cond: Tensor, dtype: torch.dtype) -> list[Modulation]:
    """Return a norm's modulation per step; gates in the network's own ``dtype``, as LeRobot casts them."""
    scale, shift, gate = norm.dense(cond).chunk(3, dim=-1)
    return [
        Modulation(1 + s.float(), h.float(), g.to(dtype)) for s, h, g in zip(scale, shift, gate, strict=True)
    ]


def _modulated(x: Tensor, by: Modulation, eps: Tensor) -> Tensor:
    return torch.addcmul(by.shift, _rms(x, eps), by.scale).to(x.dtype)


def _rms(x: Tensor, eps: Tensor) -> Tensor:
    """Return ``x`` over its root mean square, in float32 as LeRobot computes it; ``eps`` a number in a tensor."""
    wide = x.float()
    norm = torch.linalg.vector_norm(wide, dim=-1, keepdim=True)
    return wide * torch.rsqrt(torch.addcmul(eps, norm, norm, value=1 / x.shape[-1]))


def _project(layer: nn.Module, normed: Tensor) -> Tensor:
    """Return (B, heads + 2, L, head): queries, key, value."""
    a = layer.self_attn
    normed = normed.to(a.q_proj.weight.dtype)
    rows = torch.cat([a.q_proj(normed), a.k_proj(normed), a.v_proj(normed)], dim=-1)
    return rows.unflatten(-1, (-1, a.head_dim)).transpose(1, 2)


def _mlp(mlp: nn.Module, x: Tensor) -> Tensor:
    return mlp.down_proj(mlp.act_fn(mlp.gate_proj(x)).mul_(mlp.up_proj(x)))


def _rotary(model: nn.Module, x: Tensor, positions: Tensor) -> Rotary:
    """Return cos and signed sin for (B, heads + 2, L, head) rows, broadcast over the heads; values stay as they are."""
    cos, sin = model.rotary_emb(x, positions)  # (B, L, head)
    half = cos.shape[-1] // 2
    sin = torch.cat([-sin[..., :half], sin[..., half:]], dim=-1)
    heads = model.config.num_attention_heads + 1
    turned = [part[:, None].expand(-1, heads, -1, -1) for part in (cos, sin)]
    still = torch.ones_like(cos)[:, None], torch.zeros_like(sin)[:, None]
    return torch.cat([turned[0], still[0]], dim=1), torch.cat([turned[1], still[1]], dim=1)


def _rotated(rows: Tensor, rotary: Rotary) -> Tensor:
    """Return rows turned by their positions: x·cos + swap(x)·signed sin, halves swapped by rolling."""
    cos, sin = rotary
    return torch.addcmul(rows * cos, rows.roll(rows.shape[-1] // 2, dims=-1), sin)


def _attend(q: Tensor, cache: Tensor, mask: Tensor | None, layer: nn.Module) -> Tensor:
    """Return (B, L, heads·head); one key/value head serves all queries."""
    k, v = (cache[:, n : n + 1].expand(-1, q.shape[1], -1, -1) for n in (0, 1))
    mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=mask, scale=layer.self_attn.scaling)
    return mixed.transpose(1, 2).flatten(2)


def _fuse(layer: nn.Module) -> FusedLayer:
    attention, mlp = layer.self_attn, layer.mlp
    return FusedLayer(
        torch.cat([attention.q_proj.weight, attention.k_proj.weight, attention.v_proj.weight]),
        torch.cat([mlp.gate_proj.weight, mlp.up_proj.weight]),
    )
