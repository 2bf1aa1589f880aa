"""What trains: everything that somebody reads, or the adapters of LoRA; never a weight that gets no gradient.

π0.5's action loss reads the VLM through the keys and values of every layer alone. The last layer's queries, output
projection and MLP, and the VLM's final norm, are therefore trained by nobody. Frozen, they cost no optimiser state, and
data-parallel training need not look for unused parameters in every step.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import nn

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

NEW_MODULES = (
    "force_tokens",
    "state_token",
    "touch_gate",
    "next_force",
)  # random even on a pretrained backbone
EXPERT = r".*\.gemma_expert\.model\.layers\.\d+\.(self_attn\.(q|k|v|o)_proj|mlp\.(gate|up|down)_proj)"
PROJECTIONS = r"model\.(action_in_proj|action_out_proj|time_mlp_in|time_mlp_out)"


def parameter_groups(
    named: Iterable[tuple[str, nn.Parameter]], config: PI05UniforceConfig
) -> list[dict[str, Any]]:
    """Return trainable parameters in an optimiser's groups, each with its rate: backbone, new modules, gate."""
    rates = {"": None, "new": config.new_module_lr, "gate": config.touch_gate_lr}
    groups: dict[str, dict[str, Any]] = {}
    for name, parameter in named:
        if parameter.requires_grad:
            groups.setdefault(_group(name), {"params": []})["params"].append(parameter)
    return [
        groups[name] | ({} if rate is None else {"lr": rate})
        for name, rate in rates.items()
        if name in groups
    ]


def _group(name: str) -> str:
    parts = name.split(".")  # a wrapper (PEFT) may stand before or behind the module's name
    if "touch_gate" in parts:
        return "gate"
    return "new" if set(NEW_MODULES) & set(parts) else ""


def freeze_unread(network: stock.PI05Pytorch) -> None:
    """Take the gradient from the VLM's weights behind its last keys and values."""
    vlm = network.paligemma_with_expert.paligemma.model.language_model
    last = vlm.layers[-1]
    unread: list[nn.Module] = [
        vlm.norm,
        last.post_attention_layernorm,
        last.mlp,
        last.self_attn.q_proj,
        last.self_attn.o_proj,
    ]
    for module in unread:
        module.requires_grad_(False)


def lora_targets(network: stock.PI05Pytorch, saved: list[str]) -> dict[str, Any]:
    """Return PEFT's settings: which layers get adapters, and which modules train whole.

    The action expert and the action and time projections get adapters everywhere, the VLM on queries and values where
    somebody reads them. LeRobot's own list names modules π0.5 doesn't have and leaves out its time MLP.

    Args:
        network: tells how deep it is.
        saved: names of modules that start random, which no adapter can help.
    """
    depth = len(network.paligemma_with_expert.paligemma.model.language_model.layers)
    read = "|".join(str(n) for n in range(depth - 1))
    layer = r".*\.language_model\.layers\."
    vlm = rf"{layer}({read})\.self_attn\.(q|v)_proj|{layer}{depth - 1}\.self_attn\.v_proj"
    return {"target_modules": rf"({EXPERT}|{PROJECTIONS}|{vlm})", "modules_to_save": saved}
