"""Facts that a new policy takes from its training data, and the parameters that train.

π0.5's action loss reads the VLM through the keys and values of every layer alone. The last layer's queries, output
projection and MLP, and the VLM's final norm, therefore get no gradient. Frozen, they cost no optimiser state, and
data-parallel training need not look for unused parameters in every step.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from lerobot.policies.pi05 import modeling_pi05 as stock
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import ENCODED, PI05UniforceConfig
from lerobot_policy_pi05_uniforce.touch.sensors import carried_grip
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION, VIEW_MARKER, latent_key

Named = tuple[str, nn.Parameter]
# random even on a pretrained backbone
NEW_MODULES = ("force_tokens", "state_token", "touch_gate")
NEW_MODULE_RATE = {"tiny": 1.0, "base": 4.0}  # of optimizer_lr: tiny's backbone is as new
GATE_LR = 1e-3  # of the gate alone: it goes from 1e-6 to the order of 1
EXPERT = (
    r".*\.gemma_expert\.model\.layers\.\d+\.(self_attn\.(q|k|v|o)_proj|mlp\.(gate|up|down)_proj)"
)
PROJECTIONS = r"model\.(action_in_proj|action_out_proj|time_mlp_in|time_mlp_out)"
# inputs standardised by the training data


def parameter_groups(named: Iterable[Named], config: PI05UniforceConfig) -> list[dict[str, Any]]:
    """Return trainable parameters in an optimiser's groups, each with its rate: backbone, new modules, gate."""
    new = config.optimizer_lr * NEW_MODULE_RATE[config.size]
    rates: dict[str, dict[str, Any]] = {"": {}, "new": {"lr": new}, "gate": {"lr": GATE_LR}}
    groups: dict[str, list[nn.Parameter]] = {name: [] for name in rates}
    for name, parameter in named:
        # a wrapper (PEFT) may stand before or behind the module's name
        parts = set(name.split("."))
        group = "gate" if "touch_gate" in parts else "new" if parts & set(NEW_MODULES) else ""
        if parameter.requires_grad:
            groups[group].append(parameter)
    return [{"params": groups[name], **rate} for name, rate in rates.items() if groups[name]]


def freeze_unread(network: stock.PI05Pytorch) -> None:
    """Take the gradient from the VLM's weights behind its last keys and values."""
    vlm = network.paligemma_with_expert.paligemma.model.language_model
    last, attention = vlm.layers[-1], vlm.layers[-1].self_attn
    for unread in (
        vlm.norm,
        last.post_attention_layernorm,
        last.mlp,
        attention.q_proj,
        attention.o_proj,
    ):
        unread.requires_grad_(False)


def lora_targets(network: stock.PI05Pytorch) -> dict[str, Any]:
    """Return PEFT's settings: which layers get adapters, and which modules, that start random, train whole.

    The action expert and the action and time projections get adapters everywhere, the VLM on queries and values where
    they are read. LeRobot's own list names modules π0.5 doesn't have and leaves out its time MLP.
    """
    depth = len(network.paligemma_with_expert.paligemma.model.language_model.layers)
    read = "|".join(str(n) for n in range(depth - 1))
    layer = r".*\.language_model\.layers\."
    vlm = rf"{layer}({read})\.self_attn\.(q|v)_proj|{layer}{depth - 1}\.self_attn\.v_proj"
    saved = [name for name in NEW_MODULES if getattr(network, name) is not None]
    return {"target_modules": rf"({EXPERT}|{PROJECTIONS}|{vlm})", "modules_to_save": saved}


def read_touch_scale(
    stats: dict[str, dict[str, Any]], config: PI05UniforceConfig, shape: tuple[int, int]
) -> tuple[Tensor, Tensor] | None:
    """Return the touch input's mean (rows, size) and spread (size,), alike for all slots; None where there is none."""
    if config.touch.input != "latent":
        return None
    keys = [latent_key(slot) for slot in config.slots]
    rows = [stats[key] for key in keys if key in stats]
    if not rows:
        return None
    mean = torch.stack([torch.as_tensor(row["mean"]).float().reshape(shape) for row in rows]).mean(
        dim=0
    )
    stds = torch.stack([torch.as_tensor(row["std"]).float().reshape(shape) for row in rows])
    spreads = stds.square().mean(dim=1).sqrt().clamp_min(1e-3)  # an unused channel must not explode
    return mean, spreads.square().mean(dim=0).sqrt()


def read_target_range(stats: dict[str, dict[str, Any]]) -> list[list[float]]:
    """Return the lowest and the highest commanded target per axis; [] where the data don't say."""
    action = stats.get(ACTION, {})
    if "min" not in action or "max" not in action:
        return []
    return [torch.as_tensor(action[bound]).float().flatten().tolist() for bound in ("min", "max")]


def read_provenance(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Write into ``config`` which recordings it is trained on; a model card quotes it."""
    found = {name: getattr(dataset_meta, name, None) for name in ("repo_id", "fps")}
    for name in ("episodes", "frames"):  # a view also says how many of them are sampled from
        total = getattr(dataset_meta, f"total_{name}", None)
        found[name] = getattr(dataset_meta, f"used_{name}", total)
    config.trained_on = {name: str(value) for name, value in found.items() if value is not None}


def read_carried(dataset_meta: Any, config: PI05UniforceConfig, encoder: Any) -> None:
    """Note by slot which grip the demonstrations' finger reads once something is lifted, where a view's latents say."""
    episodes = getattr(dataset_meta, "touch_episodes", None)
    if episodes is None or encoder is None or encoder.head is None:
        return
    shape = config.tokens_per_slot, config.latent_size
    for slot in config.slots:
        felt = (
            (torch.from_numpy(state), _newtons(torch.from_numpy(latents), shape, encoder.head))
            for state, latents in episodes(latent_key(slot))
        )
        carried_N = carried_grip(felt)
        if carried_N is not None:
            config.touch.carried_N[slot] = carried_N


@torch.no_grad()
def _newtons(latents: Tensor, shape: tuple[int, int], head: Any) -> Tensor:
    """Return (T, 3) N that a head reads in pooled latents (T, K · latent)."""
    force_N: Tensor = head.step(latents.float().reshape(len(latents), *shape), None)[0]
    return force_N


def read_view(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Take provenance from a training view: refuse latents of another tokenizer, note which sensors it holds.

    Raises DatasetError: the view's latents were made by another tokenizer than the policy's.
    """
    marker = Path(getattr(dataset_meta, "root", "")) / VIEW_MARKER
    if dataset_meta is None or not config.slots or not marker.is_file():
        return
    view = read_object(marker, DatasetError)
    worn = getattr(dataset_meta, "sensors", {})  # finger → kinds in the episodes sampled from
    kinds = {slot: "+".join(worn.get(config.touch.slots[slot], [])) for slot in config.slots}
    config.touch.trained_sensors = {**kinds, **config.touch.trained_sensors}
    made_by = view.get("tokenizer_hash", "")
    if config.touch.input in ENCODED and made_by and made_by != config.tokenizer_hash:
        do = "Build the view again with this policy's tokenizer."
        raise DatasetError(expected(f"tokenizer of {marker}", config.tokenizer_hash, made_by, do))
