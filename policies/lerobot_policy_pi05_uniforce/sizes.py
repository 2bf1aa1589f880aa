"""Defaults of the two sizes."""

from collections.abc import Sequence
from typing import Any

import torch

from uniforce_vtla.errors import ContractError, expected

GRID = 4  # latents are pooled to 4×4: 16 tokens per slot
TWO_SLOT_DROPOUT = 0.3  # a policy of two fingers must also do with one
SIZES = ("tiny", "base")
# setting → default of (tiny, base). base: LeRobot's own π0.5 values, published weights fit them; augmentation not tried
BY_SIZE: dict[str, tuple[Any, Any]] = {
    "chunk_size": (16, 50),
    "n_action_steps": (2, 50),
    "image_resolution": ((56, 56), (224, 224)),  # tiny: 16 patches of 14² per camera
    "max_action_dim": (8, 32),
    "max_state_dim": (8, 32),
    "tokenizer_max_length": (64, 200),
    "optimizer_lr": (1e-3, 2.5e-5),
    "scheduler_warmup_steps": (3_000, 1_000),
    "scheduler_decay_steps": (100_000, 30_000),
    "scheduler_decay_lr": (1e-5, 2.5e-6),
    # tiny: from whole latents it learns what sensors don't share, docs/experiments/tiny_policy.md; base: not tried
    "touch.input": ("newtons", "latent"),
    "touch.start_at_base": (False, True),  # from scratch there is no base
    "action.form": ("target_delta", "absolute"),
    "action.objective": ("regression", "flow"),
    # tiny: a newton of press or grip is a fraction of a millimetre; without, such moves are not learnt
    "action.delta_knee": ([0.0, 0.0, 0.001, 0.0, 0.0003], []),
    # tiny: else lights are learnt by heart, docs/experiments/tiny_policy.md
    "augment.camera_variation": (1.0, 0.0),
    "sampler.noise_scale": (0.0, 1.0),
}
OFF: dict[str, Any] = {  # what no size uses by default
    "action.previous_steps": 0,
    "action.previous_axes": [],
}


def resolve_size(size: str, device: str | None) -> str:
    """Return "tiny" or "base"; "auto" takes base where CUDA runs it, since 4 B weights don't fit a laptop.

    Raises ContractError: no such size.
    """
    if size == "auto":
        cuda = torch.cuda.is_available() and (device is None or device.startswith("cuda"))
        size = "base" if cuda else "tiny"
    if size not in SIZES:
        raise ContractError(expected("size", "tiny | base | auto", repr(size), "Fix policy.size."))
    return size


def size_settings(size: str, slots: Sequence[str]) -> dict[str, Any]:
    """Return setting → default."""
    found = {path: values[SIZES.index(size)] for path, values in BY_SIZE.items()} | OFF
    return found | {"augment.touch_dropout": TWO_SLOT_DROPOUT if len(slots) > 1 else 0.0}
