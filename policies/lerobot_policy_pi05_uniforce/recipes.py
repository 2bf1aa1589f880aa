"""Defaults of the two sizes, and the recipes: ``plain``, and ``scored`` as the benchmark's arms were trained."""

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
    "n_action_steps": (6, 50),
    "image_resolution": ((56, 56), (224, 224)),  # tiny: 16 patches of 14² per camera
    "max_action_dim": (8, 32),
    "max_state_dim": (8, 32),
    "tokenizer_max_length": (64, 200),
    "optimizer_lr": (1e-3, 2.5e-5),
    "scheduler_warmup_steps": (3_000, 1_000),
    "scheduler_decay_steps": (100_000, 30_000),
    "scheduler_decay_lr": (1e-5, 2.5e-6),
    "touch.start_at_base": (False, True),  # from scratch there is no base
    "action.form": ("target_delta", "absolute"),
    "action.objective": ("regression", "flow"),
    # tiny: else lights are learnt by heart, docs/experiments/tiny_policy.md
    "augment.camera_variation": (1.0, 0.0),
    "augment.touch_noise": (0.2, 0.0),
    "sampler.noise_scale": (0.0, 1.0),
}
PLAIN: dict[str, Any] = {
    "touch.directions": 0,
    "action.delta_knee": [],
    "action.previous_steps": 0,
    "action.previous_axes": [],
    "augment.state_noise": [],
    "augment.sensor_transfer": 0.0,
}
# The nine settings of the scored arms; what each bought is in docs/experiments/tiny_policy.md
SCORED: dict[str, Any] = {
    "n_action_steps": 4,
    "action.previous_steps": 4,
    # a policy that reads that its fingers stand still leaves them so, and stalls
    "action.previous_axes": [0, 1, 2],
    # so that .4 mm of height and .03 mm of width, a newton's worth, weigh
    "action.delta_knee": [0.0, 0.0, 0.003, 0.0, 0.0003],
}
# 6 mm of height, 1.4 mm of width: no press is read off the pose
SCORED_TOUCH: dict[str, Any] = {"augment.state_noise": [0.0, 0.0, 0.2, 0.0, 0.1]}
SCORED_LATENT: dict[str, Any] = {
    "touch.directions": 4,  # grip and pull, nothing sideways, in which fingers of one grasp may disagree by newtons
    "augment.touch_noise": 1.0,  # as far apart as fingers of one grasp
    "augment.sensor_transfer": 0.2,
}
# so that the masked control shows nothing the policy never met
SCORED_ONE_SLOT: dict[str, Any] = {"augment.touch_dropout": 0.1}


def resolve_size(size: str, device: str | None) -> str:
    """Return "tiny" or "base"; "auto" takes base where CUDA runs it, since 4 B weights don't fit a laptop.

    Raises:
        ContractError: no such size.
    """
    if size == "auto":
        cuda = torch.cuda.is_available() and (device is None or device.startswith("cuda"))
        size = "base" if cuda else "tiny"
    if size not in SIZES:
        raise ContractError(expected("size", "tiny | base | auto", repr(size), "Fix policy.size."))
    return size


def recipe_settings(recipe: str, size: str, slots: Sequence[str], touch_input: str) -> dict[str, Any]:
    """Return setting → default: the size's, and over it the recipe's for this touch input."""
    found = {path: values[SIZES.index(size)] for path, values in BY_SIZE.items()} | PLAIN
    found["augment.touch_dropout"] = TWO_SLOT_DROPOUT if len(slots) > 1 else 0.0
    if recipe == "plain":
        return found
    found |= SCORED | (SCORED_TOUCH if slots else {})
    if slots and touch_input == "latent":
        found |= SCORED_LATENT | (SCORED_ONE_SLOT if len(slots) == 1 else {})
    return found
