"""The two sizes of the policy and the defaults each one brings."""

from __future__ import annotations

import logging
from typing import Any

import torch

from uniforce_vtla.errors import ContractError, expected

logger = logging.getLogger(__name__)

TINY: dict[str, Any] = {
    "chunk_size": 16,
    "n_action_steps": 6,
    "image_resolution": (56, 56),  # 16 patches of 14² per camera
    "max_action_dim": 8,
    "max_state_dim": 8,
    "tokenizer_max_length": 64,
    "state_token": True,
    "start_at_base": False,  # from scratch there is no base
    "hear_whole_pad": True,  # another finger's grip is read a fourth better: docs/experiments/tiny_policy.md
    "action_form": "target_delta",
    "action_objective": "regression",
    "sampling_noise": 0.0,
    "camera_variation": 1.0,  # else it knows its demos' lights by heart, and stalls: docs/experiments/tiny_policy.md
    "touch_noise": 0.2,  # what is left to hide once the tokenizer knows held tools: docs/experiments/tiny_policy.md
    "optimizer_lr": 1e-3,
    "new_module_lr": 1e-3,
    "scheduler_warmup_steps": 3_000,
    "scheduler_decay_steps": 100_000,
    "scheduler_decay_lr": 1e-5,
}

BASE: dict[str, Any] = {  # LeRobot's own π0.5 values; published weights fit them
    "chunk_size": 50,
    "n_action_steps": 50,
    "image_resolution": (224, 224),
    "max_action_dim": 32,
    "max_state_dim": 32,
    "tokenizer_max_length": 200,
    "state_token": False,
    "start_at_base": True,
    "hear_whole_pad": False,  # not tried at this size
    "action_form": "absolute",
    "action_objective": "flow",
    "sampling_noise": 1.0,
    "camera_variation": 0.0,  # not tried at this size
    "touch_noise": 0.0,  # not tried at this size
    "optimizer_lr": 2.5e-5,
    "new_module_lr": 1e-4,
    "scheduler_warmup_steps": 1_000,
    "scheduler_decay_steps": 30_000,
    "scheduler_decay_lr": 2.5e-6,
}


def resolve_size(size: str, device: str | None) -> str:
    """Return "tiny" or "base"; "auto" takes base where CUDA runs it, since 4 B weights don't fit a laptop."""
    if size == "auto":
        cuda = torch.cuda.is_available() and (device is None or device.startswith("cuda"))
        size = "base" if cuda else "tiny"
        logger.info("size=auto became size=%s (device %s)", size, device)
    return size


def size_defaults(size: str) -> dict[str, Any]:
    """Return the fields a size decides.

    Raises:
        ContractError: no such size.
    """
    sizes = {"tiny": TINY, "base": BASE}
    if size not in sizes:
        raise ContractError(expected("size", "tiny | base | auto", repr(size), "Fix policy.size."))
    return sizes[size]
