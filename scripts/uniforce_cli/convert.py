"""Turn a published π0.5 (folder or hub id) into a pi05_uniforce that training can start from.

Why not ``policy.pretrained_path``: LeRobot would load the published processors with it, which know
nothing of touch, and its own loader goes on with random weights after an error. Here every tensor
is placed by name or named in an error.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from uniforce_cli.boundary import by_name, command, one_thread
from uniforce_vtla.errors import CheckpointError, ContractError, expected
from uniforce_vtla.file_hashes import write_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.keys import ACTION
from uniforce_vtla.options import Existing, OutFolder, Pattern, Slots, View
from uniforce_vtla.results_file import PROVENANCE, provenance, write_json

if TYPE_CHECKING:
    from lerobot_policy_pi05_uniforce import PI05UniforceConfig

KNOWN_TYPES = ("pi05", "pi05_uniforce")
NOT_TAKEN = {  # settings that the new policy or its data decide
    "type",
    "device",
    "dtype",
    "input_features",
    "output_features",
    "normalization_mapping",
    "rtc_config",
    "pretrained_path",
    "repo_id",
    "trained_on",
    "swap",
    "left_sensor",
    "right_sensor",
    "touch",
    "augment",
}
Published = Annotated[str, Existing("a checkpoint's folder or a hub id", "config.json", hub=True)]
Revision = Annotated[
    str, Pattern("a branch, tag or commit", r"\w[\w.-]{0,99}(/\w[\w.-]{0,99})*", "main")
]


@dataclass
class ConvertConfig:
    """Give a π0.5 force tokens: its weights, fresh new modules, processors for your own data.

    Example: uniforce convert source=lerobot/pi05_base view=outputs/view224 out=outputs/pi05_touch
    then: uniforce train policy.path=outputs/pi05_touch dataset.repo_id=local/view dataset.root=…
    """

    source: Published = "lerobot/pi05_base"  # a pi05, or a pi05_uniforce to change its touch
    # training view of your demos (uniforce view image_side=224), for features and statistics
    view: View = ""
    out: OutFolder = "outputs/converted"  # the new policy's folder
    # touch that the policy feels; wrench is the simulator's true one, a ceiling
    touch_input: Literal["latent", "none", "wrench"] = "latent"
    # which finger fills which touch slot, comma between them
    touch_slots: Slots = "touch0:right,touch1:left"
    # training starts with the source's actions, touch behind a gate (touch/tokens.py)
    start_at_base: bool = True
    # number format of the backbone; a tiny source stays float32
    dtype: Literal["bfloat16", "float32"] = "bfloat16"
    revision: Revision = ""  # branch, tag or commit of a hub repository; "" = its newest


def convert(config: ConvertConfig) -> Path:
    """Build, fill and save the policy with its processors; return its folder.

    Raises CheckpointError: no π0.5 there, a damaged file, or tensors that are missing, left over or
    misshapen; ContractError: settings that don't go together; DatasetError: no view, or one that
    lacks the touch input.
    """
    from lerobot.utils.feature_utils import dataset_to_policy_features

    from lerobot_policy_pi05_uniforce import PI05UniforcePolicy, weights
    from lerobot_policy_pi05_uniforce import (
        make_pi05_uniforce_pre_post_processors as make_processors,
    )
    from uniforce_datasets.training_view import TrainingView

    out = Path(config.out)
    if out.is_dir() and any(out.iterdir()):
        do = "Choose another out, or remove it."
        raise ContractError(expected(str(out), "an empty folder", "one with files", do))
    if config.revision and Path(config.source).exists():
        raise ContractError(
            expected("revision", "a hub id as source", config.source, "Leave it out.")
        )
    revision = config.revision or None
    source = read_object(weights.find(config.source, weights.CONFIG, revision), CheckpointError)
    if source.get("type") not in KNOWN_TYPES:
        where = f"policy type of {config.source}"
        do = "Name a π0.5 checkpoint."
        raise CheckpointError(expected(where, " | ".join(KNOWN_TYPES), source.get("type"), do))
    weights.check_files(config.source, "full", revision, local_files_only=False)
    slots = by_name(config.touch_slots)
    view = TrainingView(config.view, slots=slots, touch=config.touch_input)
    settings = _settings(source, config, slots)
    features = dataset_to_policy_features(view.meta.features)
    settings.output_features = {ACTION: features.pop(ACTION)}
    settings.input_features = features
    policy = PI05UniforcePolicy(
        settings, dataset_stats=view.meta.stats, dataset_meta=view.meta, empty=True
    )
    file = weights.find(config.source, weights.WEIGHTS, revision)
    weights.fill(policy, file, weights.own_names, weights.FRESH)
    before, after = make_processors(settings, view.meta.stats)
    for part in (policy, before, after):
        part.save_pretrained(out)
    write_json(out / PROVENANCE, provenance())
    write_hashes(out)
    return out


def _settings(
    source: dict[str, Any], config: ConvertConfig, slots: dict[str, str]
) -> PI05UniforceConfig:
    """Return the source's sizes and flow with this project's touch."""
    import draccus

    from lerobot_policy_pi05_uniforce import PI05UniforceConfig
    from lerobot_policy_pi05_uniforce import configuration_pi05_uniforce as groups

    known = {field.name for field in fields(PI05UniforceConfig) if field.init} - NOT_TAKEN
    taken = {name: value for name, value in source.items() if name in known}
    kinds = {
        "action": groups.ActionSettings,
        "tiny": groups.TinySettings,
        "sampler": groups.SamplerSettings,
    }
    for name in kinds.keys() & taken.keys():
        taken[name] = draccus.decode(kinds[name], taken[name])
    for path, only in groups.REMOVED.items():
        group, _, name = path.partition(".")
        if group in taken:
            setattr(taken[group], name, only)
    taken.setdefault("size", "base")
    touch = groups.TouchSettings(slots, config.touch_input, start_at_base=config.start_at_base)
    dtype = "float32" if taken["size"] == "tiny" else config.dtype
    return PI05UniforceConfig(**taken, device="cpu", dtype=dtype, touch=touch)


@command(ConvertConfig)
def main(config: ConvertConfig) -> None:
    from lerobot_policy_pi05_uniforce import weights

    one_thread()
    if not config.view:
        raise ContractError(
            expected("view", "a training view's folder", "none", "Build one with uniforce view.")
        )
    out = convert(config)
    print(f"policy in {out}; new modules start fresh: {', '.join(weights.FRESH)}")
    data = f"dataset.repo_id=local/view dataset.root={config.view}"
    print(f"next: uniforce train policy.path={out} {data}")
