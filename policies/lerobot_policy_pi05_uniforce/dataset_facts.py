"""What a policy learns about its touch input from the training data: its scale, and whose latents they are."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from lerobot_policy_pi05_uniforce.force_tokens import channel_spread
from lerobot_policy_pi05_uniforce.touch_input import touch_shape
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION, VIEW_MARKER, descriptor_key, latent_key

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig

SCALED = {
    "latent": latent_key,
    "descriptor": descriptor_key,
}  # inputs standardised by the training data


def read_touch_scale(
    stats: dict[str, dict[str, Any]], config: PI05UniforceConfig
) -> tuple[Tensor, Tensor] | None:
    """Return the touch input's mean (rows, size) and spread (size,), alike for all slots; None where there is none."""
    if config.touch_input not in SCALED:
        return None
    key, shape = SCALED[config.touch_input], touch_shape(config)
    rows = [stats[key(slot)] for slot in config.slots if key(slot) in stats]
    if not rows:
        return None
    mean = torch.stack([torch.as_tensor(row["mean"]).float().reshape(shape) for row in rows]).mean(dim=0)
    spreads = torch.stack([channel_spread(torch.as_tensor(row["std"]), shape[1]) for row in rows])
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


def read_view(dataset_meta: Any, config: PI05UniforceConfig) -> None:
    """Take provenance from a training view: refuse latents of another tokenizer, note which sensors it holds.

    Raises:
        DatasetError: the view's latents were made by another tokenizer than the policy's.
    """
    marker = Path(getattr(dataset_meta, "root", "")) / VIEW_MARKER
    if dataset_meta is None or not config.slots or not marker.is_file():
        return
    view = read_object(marker, DatasetError)
    worn = getattr(dataset_meta, "sensors", {})  # finger → kinds in the episodes sampled from
    kinds = {slot: "+".join(worn.get(config.touch_slots[slot], [])) for slot in config.slots}
    config.trained_sensors = {**kinds, **config.trained_sensors}
    made_by = view.get("tokenizer_hash", "")
    if config.touch_input == "latent" and made_by and made_by != config.tokenizer_hash:
        do = "Build the view again with this policy's tokenizer."
        raise DatasetError(expected(f"tokenizer of {marker}", config.tokenizer_hash, made_by, do))
