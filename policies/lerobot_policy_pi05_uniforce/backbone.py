"""VLM and action expert of both sizes: LeRobot's own with gated touch, and one small enough for one CPU core."""

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
Streams = list[Tensor]  # VLM prefix (B, L0, D0) and expert suffix (B, L1, D1)
Layers = tuple[nn.Module, ...]  # the VLM's and the expert's at one depth


class GatedBackbone(stock.PaliGemmaWithExpertModel):
    """LeRobot's VLM and action expert, in whose attention touch has the weight that its gate gives.

    ``gated`` is set by every ``embed_prefix`` and stays until the next: gradient checkpointing runs this again later.
    """

    gated: GatedColumns | None = None

    def forward(
        self,
        attention_mask: Tensor,
        position_ids: Tensor,
        past_key_values: object,
        inputs_embeds: list,
        use_cache: bool | None = None,
        adarms_cond: list | None = None,
    ) -> tuple[list, object]:
        """Run prefix, suffix or both; arguments as LeRobot's."""
        if self.gated is not None:
            position_ids = self.gated.placed(position_ids, attention_mask.shape[-1])
            attention_mask = self.gated.masked(attention_mask)
        cond = adarms_cond or [None, None]
        return self.run_layers(attention_mask, position_ids, past_key_values, inputs_embeds, cond)

    def run_layers(
        self, mask: Tensor, positions: Tensor, past: Any, streams: list, cond: list
    ) -> Any:
        """Run LeRobot's own layers; a prefix alone fills the cache."""
        cached = streams[1] is None
        return super().forward(mask, positions, past, streams, use_cache=cached, adarms_cond=cond)


class TinyBackbone(GatedBackbone):
    """PaliGemma and the action expert with small widths: the same classes, built from small configurations."""

    fused = True  # False: LeRobot's own layers, which the bench and tests compare with

    def __init__(self, config: PI05UniforceConfig) -> None:
        nn.Module.__init__(self)  # the parent would build the 4 B model
        self.freeze_vision_encoder = config.freeze_vision_encoder
        self.train_expert_only = config.train_expert_only
        width, plain = config.tiny.width, {"use_adarms": False, "adarms_cond_dim": None}
        vlm = stock.CONFIG_MAPPING["paligemma"](
            text_config={"model_type": "gemma", **plain, **_gemma(config)},
            vision_config=_siglip(config),
            projection_dim=width,
            image_token_index=VOCABULARY - 1,
        )
        expert = stock.CONFIG_MAPPING["gemma"](
            use_adarms=True, adarms_cond_dim=width, **_gemma(config)
        )
        self.paligemma = stock.PaliGemmaForConditionalGenerationWithPiGemma(config=vlm)
        self.gemma_expert = stock.PiGemmaForCausalLM(config=expert)
        self.gemma_expert.model.embed_tokens = None  # the expert only ever sees actions
        self.to_bfloat16_for_selected_params(config.dtype)
        self._set_requires_grad()

    def run_layers(
        self, mask: Tensor, positions: Tensor, past: Any, streams: list, cond: list
    ) -> Any:
        """Run both streams, as training does, fused; one stream alone runs in LeRobot's layers."""
        if None in streams or not self.fused:
            return super().run_layers(mask, positions, past, streams, cond)
        vlm, expert = self.paligemma.model.language_model, self.gemma_expert.model
        rotary, last = vlm.rotary_emb(streams[0], positions), len(vlm.layers) - 1
        for depth, layers in enumerate(zip(vlm.layers, expert.layers, strict=True)):
            streams = joint_layer(streams, layers, mask, rotary, cond, last=depth == last)
        suffix, _ = layernorm_forward(expert.norm, streams[-1], cond[-1])
        return [None, suffix], None  # the prefix is not read


def make_backbone(config: PI05UniforceConfig) -> GatedBackbone:
    """Return VLM and action expert of the size asked for, with random weights."""
    if config.size == "tiny":
        return TinyBackbone(config)
    variants = config.paligemma_variant, config.action_expert_variant
    return GatedBackbone(
        *(stock.get_gemma_config(variant) for variant in variants),
        use_adarms=[False, True],
        precision=config.dtype,
        image_size=config.image_resolution[0],
        freeze_vision_encoder=config.freeze_vision_encoder,
        train_expert_only=config.train_expert_only,
    )


def joint_layer(
    streams: Streams, layers: Layers, mask: Tensor, rotary: tuple, cond: list, last: bool
) -> Streams:
    """Run one layer of both streams: attention over all tokens together, the rest per stream.

    With torch's fused attention: LeRobot's own loop builds every attention matrix, which on a CPU is half of a training
    step. Same weights, same mathematics, another order of summation: equal within 1e-5 (tests compare them).

    Args:
        streams: prefix and suffix embeddings.
        layers: the VLM's and the expert's decoder layer at this depth.
        mask: (B, 1, L, L) additive, L = L0 + L1.
        rotary: (cos, sin), each (B, L, head_dim).
        cond: per stream, the time condition of its adaptive norms (B, D), or None.
        last: return the suffix only.
    """
    rows = zip(layers, streams, cond, strict=True)
    normed = [layernorm_forward(layer.input_layernorm, x, c) for layer, x, c in rows]
    kept = slice(-1 if last else 0, None)
    attended = _attend(
        [x for x, _ in normed], layers, mask, rotary, [x.shape[1] for x in streams[kept]]
    )
    out = []
    for layer, x, (_, gate), a, c in zip(
        layers[kept], streams[kept], normed[kept], attended, cond[kept], strict=True
    ):
        x = _gated_residual(x, layer.self_attn.o_proj(a), gate)
        hidden, gate = layernorm_forward(layer.post_attention_layernorm, x, c)
        out.append(_gated_residual(x, layer.mlp(hidden), gate))
    return out


def _attend(
    normed: Streams, layers: Layers, mask: Tensor, rotary: tuple, lengths: list[int]
) -> list[Tensor]:
    """Let the last ``sum(lengths)`` tokens attend to all; return one (B, length, heads·head) per length."""
    # (B, heads, L, head)
    q, k, v = (_project(normed, layers, n) for n in ("q_proj", "k_proj", "v_proj"))
    q, k = apply_rotary_pos_emb(q, k, *rotary, unsqueeze_dim=1)
    # one key/value head serves all queries
    k, v = (x.expand(-1, q.shape[1], -1, -1) for x in (k, v))
    q, mask = q[:, :, -sum(lengths) :], mask[:, :, -sum(lengths) :]
    scale = layers[0].self_attn.scaling
    mixed = nn.functional.scaled_dot_product_attention(q, k, v, attn_mask=mask, scale=scale)
    return list(mixed.transpose(1, 2).flatten(2).split(lengths, dim=1))


def _project(normed: Streams, layers: Layers, name: str) -> Tensor:
    head, rows = layers[0].self_attn.head_dim, zip(layers, normed, strict=True)
    parts = [getattr(layer.self_attn, name)(x).unflatten(-1, (-1, head)) for layer, x in rows]
    return torch.cat(parts, dim=1).transpose(1, 2)


def _sizes(config: PI05UniforceConfig, depth: int, **others: Any) -> dict[str, Any]:
    tiny = config.tiny
    sizes = {
        "hidden_size": tiny.width,
        "intermediate_size": tiny.mlp_dim,
        "num_hidden_layers": depth,
    }
    return sizes | {"num_attention_heads": NUM_HEADS, **others}


def _gemma(config: PI05UniforceConfig) -> dict[str, Any]:
    kind = {"vocab_size": VOCABULARY, "hidden_activation": "gelu_pytorch_tanh", "dtype": "float32"}
    head = config.tiny.width // NUM_HEADS
    return _sizes(config, config.tiny.depth, num_key_value_heads=1, head_dim=head, **kind)


def _siglip(config: PI05UniforceConfig) -> dict[str, Any]:
    seen = {
        "patch_size": PATCH_PX,
        "image_size": config.image_resolution[0],
        "vision_use_head": False,
    }
    kind = {"model_type": "siglip_vision_model", "projection_dim": config.tiny.width}
    return _sizes(config, config.tiny.depth // 2, **kind, **seen)
