"""A checkpoint folder as settings, and as a policy between its processors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import make_pre_post_processors

from lerobot_policy_pi05_uniforce import weights
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import PI05UniforceConfig
from lerobot_policy_pi05_uniforce.modeling_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce.stored_settings import check_processors, check_settings, misfits_named
from uniforce_vtla.errors import CheckpointError, expected


def stored_config(checkpoint: Path) -> PI05UniforceConfig:
    """Return the checked settings of a checkpoint folder, to be run on the CPU.

    Raises:
        CheckpointError: no such folder, another policy, or settings that don't fit this package.
    """
    check_settings(weights.read_config(weights.find(checkpoint, weights.CONFIG)), str(checkpoint))
    check_processors(checkpoint)
    with misfits_named(str(checkpoint)):
        config = PreTrainedConfig.from_pretrained(checkpoint)
    if not isinstance(config, PI05UniforceConfig):
        raise CheckpointError(expected("policy type", "pi05_uniforce", config.type, "Choose another folder."))
    config.device = "cpu"
    config.pretrained_path = checkpoint
    return config


def stored_policy(config: PI05UniforceConfig) -> tuple[PI05UniforcePolicy, Any, Any]:
    """Return the policy of ``stored_config``'s folder, what runs before it and what runs after it.

    Raises:
        CheckpointError: weights or processors that are missing, damaged or don't fit.
    """
    folder = str(config.pretrained_path)
    policy = PI05UniforcePolicy.from_pretrained(folder, config=config)
    with misfits_named(f"processors of {folder}"):
        return policy, *make_pre_post_processors(config, pretrained_path=folder)
