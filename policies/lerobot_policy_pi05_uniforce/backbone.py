"""VLM and action expert: LeRobot's own with gated touch, or small for one CPU core."""

from typing import Any

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from lerobot.policies.pi_gemma import _gated_residual, layernorm_forward
from torch import Tensor, nn
from transformers.models.gemma.modeling_gemma import apply_rotary_pos_emb

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.processor_pi05_uniforce import VOCABULARY
from lerobot_policy_pi05_uniforce.touch.tokens import GatedColumns

NUM_HEADS = 8  # LeRobot's joint layer multiplies by 8
PATCH_PX = 14  # SigLIP's patch, as in the real model


class GatedBackbone(stock.PaliGemmaWithExpertModel):
    """LeRobot's VLM and action expert, with the gate's weight of touch in attention.

    ``gated`` is set by every ``embed_prefix`` and stays until the next: gradient checkpointing runs
    the forward pass again later.
    """

    gated: GatedColumns | None = None
    fused = False  # True: prefix and suffix together run in ``joint_layer``, not LeRobot's layers

    def forward(
        self,
        attention_mask: Tensor,
        position_ids: Tensor,
        past_key_values: Any,
        inputs_embeds: list,
        use_cache: bool | None = None,
        adarms_cond: Any = None,
    ) -> tuple[list, Any]:
        """Run prefix, suffix or both; arguments as LeRobot's."""
        if self.gated is not None:
            position_ids = self.gated.placed(position_ids, attention_mask.shape[-1])
            attention_mask = self.gated.masked(attention_mask)
        prefix, suffix = inputs_embeds
        if not self.fused or prefix is None or suffix is None:
            return super().forward(
                attention_mask,
                position_ids,
                past_key_values,
                inputs_embeds,
                use_cache,
                adarms_cond,
            )
        vlm = self.paligemma.model.language_model
        expert = self.gemma_expert.model
        rotary = vlm.rotary_emb(prefix, position_ids)
        streams = inputs_embeds
        for layers in zip(vlm.layers, expert.layers, strict=True):
            last = layers[0] is vlm.layers[-1]
            streams = joint_layer(streams, layers, attention_mask, rotary, adarms_cond, last)
        suffix, _ = layernorm_forward(expert.norm, streams[-1], adarms_cond[-1])
        return [None, suffix], None  # the prefix is not read


class TinyBackbone(GatedBackbone):
    """PaliGemma and the action expert with small widths: the same classes."""

    fused = True

    def __init__(self, config: PI05UniforceConfig) -> None:
        nn.Module.__init__(self)  # the parent would build the 4 B model
        self.freeze_vision_encoder = config.freeze_vision_encoder
        self.train_expert_only = config.train_expert_only
        tiny = config.tiny
        sizes = {
            "hidden_size": tiny.width,
            "intermediate_size": tiny.mlp_dim,
            "num_attention_heads": NUM_HEADS,
        }
        gemma = {
            **sizes,
            "num_hidden_layers": tiny.depth,
            "num_key_value_heads": 1,
            "head_dim": tiny.width // NUM_HEADS,
            "vocab_size": VOCABULARY,
            "hidden_activation": "gelu_pytorch_tanh",
            "dtype": "float32",
        }
        siglip = {
            **sizes,
            "model_type": "siglip_vision_model",
            "num_hidden_layers": tiny.depth // 2,
            "projection_dim": tiny.width,
            "patch_size": PATCH_PX,
            "image_size": config.image_resolution[0],
            "vision_use_head": False,
        }
        plain = {"model_type": "gemma", "use_adarms": False, "adarms_cond_dim": None}
        vlm = stock.CONFIG_MAPPING["paligemma"](
            text_config=plain | gemma,
            vision_config=siglip,
            projection_dim=tiny.width,
            image_token_index=VOCABULARY - 1,
        )
        expert = stock.CONFIG_MAPPING["gemma"](use_adarms=True, adarms_cond_dim=tiny.width, **gemma)
        self.paligemma = stock.PaliGemmaForConditionalGenerationWithPiGemma(config=vlm)
        self.gemma_expert = stock.PiGemmaForCausalLM(config=expert)
        self.gemma_expert.model.embed_tokens = None  # the expert only ever sees actions
        self.to_bfloat16_for_selected_params(config.dtype)
        self._set_requires_grad()


def make_backbone(config: PI05UniforceConfig) -> GatedBackbone:
    """Return VLM and action expert of the size asked for, with random weights."""
    if config.size == "tiny":
        return TinyBackbone(config)
    return GatedBackbone(
        stock.get_gemma_config(config.paligemma_variant),
        stock.get_gemma_config(config.action_expert_variant),
        use_adarms=[False, True],
        precision=config.dtype,
        image_size=config.image_resolution[0],
        freeze_vision_encoder=config.freeze_vision_encoder,
        train_expert_only=config.train_expert_only,
    )


def joint_layer(
    streams: list[Tensor],
    layers: tuple[nn.Module, ...],
    mask: Tensor,
    rotary: tuple[Tensor, Tensor],
    cond: list,
    last: bool,
) -> list[Tensor]:
    """Run one layer of both streams: attention over all tokens together, the rest per stream.

    Uses torch's fused attention: LeRobot's loop builds every attention matrix, half of a training
    step on a CPU. Same weights and mathematics, another order of summation: equal within 1e-5.

    Args:
        streams: VLM prefix (B, L0, D0) and expert suffix (B, L1, D1).
        layers: the VLM's and the expert's decoder layer at this depth.
        mask: (B, 1, L, L) additive, L = L0 + L1.
        rotary: (cos, sin), each (B, L, head_dim).
        cond: per stream, the time condition of its adaptive norms (B, D), or None.
        last: return the suffix only.
    """
    gates = []
    projected = []
    for number, layer in enumerate(layers):
        attention = layer.self_attn
        normed, gate = layernorm_forward(layer.input_layernorm, streams[number], cond[number])
        gates.append(gate)
        qkv = [attention.q_proj(normed), attention.k_proj(normed), attention.v_proj(normed)]
        projected.append(torch.cat(qkv, dim=-1))  # (B, L·, (heads + 2) · head)
    rows = torch.cat(projected, dim=1).unflatten(-1, (-1, attention.head_dim))
    rows = rows.transpose(1, 2)  # (B, heads + 2, L, head)
    q, k = apply_rotary_pos_emb(rows[:, :-2], rows[:, -2:-1], *rotary, unsqueeze_dim=1)
    first = int(last)
    lengths = [x.shape[1] for x in streams[first:]]
    read = sum(lengths)
    mixed = nn.functional.scaled_dot_product_attention(
        q[:, :, -read:],
        k.expand_as(q),  # one key/value head serves all queries
        rows[:, -1:].expand_as(q),
        attn_mask=mask[:, :, -read:],
        scale=layers[0].self_attn.scaling,
    )
    out = []
    parts = mixed.transpose(1, 2).flatten(2).split(lengths, dim=1)  # (B, L·, heads · head) each
    for number, attended in enumerate(parts, start=first):
        layer = layers[number]
        x = _gated_residual(streams[number], layer.self_attn.o_proj(attended), gates[number])
        hidden, gate = layernorm_forward(layer.post_attention_layernorm, x, cond[number])
        out.append(_gated_residual(x, layer.mlp(hidden), gate))
    return out
