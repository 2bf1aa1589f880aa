"""Facts that a new policy takes from its training data, and the parameters that train.

π0.5's action loss reads the VLM only through the keys and values of every layer. The last layer's
queries, output projection and MLP, and the VLM's final norm, therefore get no gradient. Frozen,
they cost no optimiser state, and data-parallel training needn't look for unused parameters.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import ENCODED, PI05UniforceConfig
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import (
    ACTION,
    STATE,
    VIEW_MARKER,
    force_axes,
    latent_key,
    tactile_key,
    wrench_key,
)

# random even on a pretrained backbone
NEW_MODULES = ("force_tokens", "state_token", "touch_gate")
NEW_MODULE_RATE = {"tiny": 1.0, "base": 4.0}  # of optimizer_lr: tiny's backbone is as new
GATE_LR = 1e-3  # of the gate alone: it goes from 1e-6 to the order of 1
EXPERT = (
    r".*\.gemma_expert\.model\.layers\.\d+\.(self_attn\.(q|k|v|o)_proj|mlp\.(gate|up|down)_proj)"
)
PROJECTIONS = r"model\.(action_in_proj|action_out_proj|time_mlp_in|time_mlp_out)"


def parameter_groups(
    named: Iterable[tuple[str, nn.Parameter]], config: PI05UniforceConfig
) -> list[dict[str, Any]]:
    """Return trainable parameters in an optimiser's groups: backbone, new modules, gate."""
    new_lr = config.optimizer_lr * NEW_MODULE_RATE[config.size]
    backbone: dict[str, Any] = {"params": []}
    new: dict[str, Any] = {"params": [], "lr": new_lr}
    gate: dict[str, Any] = {"params": [], "lr": GATE_LR}
    for name, parameter in named:
        parts = name.split(".")  # a wrapper (PEFT) may stand before or behind the module's name
        group = backbone
        if "touch_gate" in parts:
            group = gate
        elif not set(NEW_MODULES).isdisjoint(parts):
            group = new
        if parameter.requires_grad:
            group["params"].append(parameter)
    return [group for group in (backbone, new, gate) if group["params"]]


def freeze_unread(vlm: nn.Module) -> None:
    """Take the gradient from the VLM's weights behind its last keys and values."""
    last = vlm.layers[-1]
    attention = last.self_attn
    unread = (vlm.norm, last.post_attention_layernorm, last.mlp, attention.q_proj, attention.o_proj)
    for module in unread:
        module.requires_grad_(False)


def lora_targets(network: Any) -> dict[str, Any]:
    """Return PEFT's settings: layers that get adapters, and new modules, which train whole.

    The action expert and the action and time projections get adapters everywhere, the VLM on
    queries and values where they are read. LeRobot's list names modules π0.5 doesn't have and
    leaves out its time MLP.
    """
    last = len(network.vlm.layers) - 1
    read = "|".join(map(str, range(last)))
    layer = r".*\.language_model\.layers\."
    vlm = rf"{layer}({read})\.self_attn\.(q|v)_proj|{layer}{last}\.self_attn\.v_proj"
    saved = [name for name in NEW_MODULES if getattr(network, name) is not None]
    return {"target_modules": rf"({EXPERT}|{PROJECTIONS}|{vlm})", "modules_to_save": saved}


def read_touch_scale(
    stats: dict[str, dict[str, Any]], config: PI05UniforceConfig
) -> tuple[Tensor, Tensor] | None:
    """Return the latents' mean (K, L) and spread (L,) over all slots; None without latents."""
    means = []
    spreads = []
    for slot in config.slots:
        row = stats.get(latent_key(slot))
        if row is None or config.touch.input != "latent":
            continue
        means.append(torch.as_tensor(row["mean"]).float().reshape(config.touch_shape))
        std = torch.as_tensor(row["std"]).float().reshape(config.touch_shape)
        spread = std.square().mean(dim=0).sqrt()  # (L,)
        spreads.append(spread.clamp_min(1e-3))  # an unused channel must not explode
    if not means:
        return None
    return torch.stack(means).mean(dim=0), torch.stack(spreads).square().mean(dim=0).sqrt()


def read_target_range(stats: dict[str, dict[str, Any]]) -> list[list[float]]:
    """Return the lowest and the highest commanded target per axis; [] where the data don't say."""
    action = stats.get(ACTION, {})
    if "min" not in action or "max" not in action:
        return []
    return [torch.as_tensor(action[bound]).float().flatten().tolist() for bound in ("min", "max")]


def read_provenance(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Write into ``config`` which recordings it is trained on; a model card quotes it."""
    found = {
        "repo_id": getattr(dataset_meta, "repo_id", None),
        "fps": getattr(dataset_meta, "fps", None),
    }
    for name in ("episodes", "frames"):  # a view also says how many of them are sampled from
        total = getattr(dataset_meta, f"total_{name}", None)
        found[name] = getattr(dataset_meta, f"used_{name}", total)
    config.trained_on = {name: str(value) for name, value in found.items() if value is not None}


def refuse_force_in_state(dataset_meta: Any) -> None:
    """Raise DatasetError where a dataset's state holds newtons, made for policies without touch."""
    features = getattr(dataset_meta, "features", {})
    names = features.get(STATE, {}).get("names") or ()
    forces = {axis for finger in FINGERS for axis in force_axes(finger)} & set(names)
    if forces:
        do = "This policy feels by itself: train on the recorded dataset, or on its training view."
        came = f"also {', '.join(sorted(forces))}"
        raise DatasetError(expected("state of the dataset", "the five axes alone", came, do))


def refuse_unseen_fingers(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Raise DatasetError where a dataset shows nothing of a finger that the policy feels with."""
    features = getattr(dataset_meta, "features", {})
    if not features:
        return
    fingers = config.finger_by_slot()
    for slot in config.slots:
        finger = fingers[slot]
        keys = {latent_key(slot), tactile_key(finger)}
        if config.touch.input == "wrench":
            keys = {wrench_key(slot)}
        if keys.isdisjoint(features):
            wanted = " or ".join(sorted(keys))
            do = "Leave that finger out, e.g. policy.touch.slots='{touch0: right}'."
            raise DatasetError(expected(f"{slot}, {finger} finger", wanted, "neither", do))


def read_latent_columns(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Note which sensors made the latents in a dataset's columns (``uniforce view form=dataset``).

    Raises DatasetError: they are another tokenizer's or another finger's than the policy's slot.
    """
    features = getattr(dataset_meta, "features", {})
    for slot in config.slots:
        info = features.get(latent_key(slot), {}).get("info")
        if info is None or config.touch.input not in ENCODED:
            continue
        config.touch.trained_sensors[slot] = str(info.get("sensors", ""))
        wanted = f"finger {config.touch.slots[slot]}, tokenizer {config.tokenizer_hash}"
        came = f"finger {info.get('finger')}, tokenizer {info.get('tokenizer')}"
        if came != wanted:
            do = "Make the dataset again with this policy's tokenizer and slots."
            raise DatasetError(expected(f"latents of {slot}", wanted, came, do))


def read_view(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Note which sensors a training view holds.

    Raises DatasetError: the view's latents were made by another tokenizer than the policy's.
    """
    marker = Path(getattr(dataset_meta, "root", "")) / VIEW_MARKER
    if dataset_meta is None or not config.slots or not marker.is_file():
        return
    view = read_object(marker, DatasetError)
    sensors = getattr(dataset_meta, "sensors", {})  # finger → types in the episodes sampled from
    for slot in config.slots:
        types = "+".join(sensors.get(config.touch.slots[slot], []))
        config.touch.trained_sensors[slot] = types or config.touch.trained_sensors.get(slot, "")
    made_by = view.get("tokenizer_hash", "")
    if config.touch.input in ENCODED and made_by and made_by != config.tokenizer_hash:
        do = "Build the view again with this policy's tokenizer."
        raise DatasetError(expected(f"tokenizer of {marker}", config.tokenizer_hash, made_by, do))
