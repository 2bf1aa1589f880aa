"""A π0.5 small enough for one CPU core: the same classes as the 4 B model, built from small configurations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.joint_layers import joint_layer
from lerobot_policy_pi05_uniforce.local_tokenizer import vocabulary_size
from lerobot_policy_pi05_uniforce.touch_gate import GatedBackbone

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

NUM_HEADS = 8  # LeRobot's joint layer multiplies by 8
PATCH_PX = 14  # SigLIP's patch, as in the real model


class TinyPaliGemmaWithExpert(GatedBackbone):
    """PaliGemma and the action expert with small widths; everything after construction is LeRobot's code."""

    fused = True  # False: LeRobot's own layers, which the bench and tests compare with

    def __init__(self, config: PI05UniforceConfig) -> None:
        nn.Module.__init__(self)  # the parent would build the 4 B model
        self.freeze_vision_encoder = config.freeze_vision_encoder
        self.train_expert_only = config.train_expert_only
        vlm = stock.CONFIG_MAPPING["paligemma"](
            text_config={
                "model_type": "gemma",
                "use_adarms": False,
                "adarms_cond_dim": None,
                **_gemma(config),
            },
            vision_config=_siglip(config),
            projection_dim=config.tiny_width,
            image_token_index=_vocabulary() - 1,
        )
        expert = stock.CONFIG_MAPPING["gemma"](
            use_adarms=True, adarms_cond_dim=config.tiny_width, **_gemma(config)
        )
        self.paligemma = stock.PaliGemmaForConditionalGenerationWithPiGemma(config=vlm)
        self.gemma_expert = stock.PiGemmaForCausalLM(config=expert)
        self.gemma_expert.model.embed_tokens = None  # the expert only ever sees actions
        self.to_bfloat16_for_selected_params(config.dtype)
        self._set_requires_grad()

    def run_layers(
        self,
        mask: Tensor | None,
        positions: Tensor | None,
        past: Any,
        streams: list,
        use_cache: bool | None,
        cond: list,
    ) -> tuple[list, Any]:
        """Embed the prefix as LeRobot does; run both streams (training) or the suffix (sampling) fused."""
        if streams[1] is None or not self.fused:
            return super().run_layers(mask, positions, past, streams, use_cache, cond)
        assert mask is not None and positions is not None, "LeRobot always gives both"
        both = [self.paligemma.model.language_model, self.gemma_expert.model]
        first = 0 if streams[0] is not None else 1
        suffix = _run(both[first:], streams[first:], mask, positions, cond[first:], past)
        return [None, suffix], None  # LeRobot reads the prefix for its cache alone


def _run(
    models: list[nn.Module], streams: list[Tensor], mask: Tensor, positions: Tensor, cond: list, cache: Any
) -> Tensor:
    rotary = models[0].rotary_emb(streams[0], positions)
    depths = list(zip(*(model.layers for model in models), strict=True))
    for depth, layers in enumerate(depths):
        past = None if cache is None else (cache.layers[depth].keys, cache.layers[depth].values)
        last = depth == len(depths) - 1
        streams = joint_layer(streams, list(layers), mask, rotary, cond, past, last)
    return stock.layernorm_forward(models[-1].norm, streams[-1], cond[-1])[0]


def _vocabulary() -> int:
    return -(-(vocabulary_size() + 1) // 64) * 64  # one spare id for the image token, rounded up to 64


def _gemma(config: PI05UniforceConfig) -> dict[str, Any]:
    return {
        "hidden_size": config.tiny_width,
        "intermediate_size": config.tiny_mlp_dim,
        "num_hidden_layers": config.tiny_depth,
        "num_attention_heads": NUM_HEADS,
        "num_key_value_heads": 1,
        "head_dim": config.tiny_head_dim,
        "vocab_size": _vocabulary(),
        "hidden_activation": "gelu_pytorch_tanh",
        "dtype": "float32",
    }


def _siglip(config: PI05UniforceConfig) -> dict[str, Any]:
    return {
        "model_type": "siglip_vision_model",
        "hidden_size": config.tiny_width,
        "intermediate_size": config.tiny_mlp_dim,
        "num_hidden_layers": config.tiny_vision_depth,
        "num_attention_heads": NUM_HEADS,
        "patch_size": PATCH_PX,
        "image_size": config.image_resolution[0],
        "projection_dim": config.tiny_width,
        "vision_use_head": False,
    }
