"""A training run's state on disk: weights, optimiser and step as safetensors, so that resuming unpickles nothing."""

import json
from pathlib import Path
from typing import Any

import safetensors
import torch
from safetensors.torch import save_file

from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.tokenizer.weights import is_finite

STATE = "state.safetensors"
MODEL, MOMENTS = "model.", "optimizer."


def save_state(folder: Path, step: int, model: dict[str, Any], optimizer: dict[str, Any]) -> Path:
    """Write both state dicts atomically."""
    tensors = {MODEL + name: value for name, value in model.items()}
    for number, moments in optimizer["state"].items():
        tensors |= {f"{MOMENTS}{number}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    tensors = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    facts = {"step": str(step), "groups": json.dumps(optimizer["param_groups"])}
    scratch = folder / "state.tmp"
    save_file(tensors, scratch, metadata=facts)
    scratch.replace(folder / STATE)
    return folder / STATE


def load_state(folder: Path) -> tuple[int, dict[str, Any], dict[str, Any]]:
    """Return step, the model's state dict and the optimiser's.

    Raises CheckpointError: truncated, damaged, not a training state, or with NaN or inf.
    """
    path = folder / STATE
    try:
        with safetensors.safe_open(path, framework="pt") as stored:
            facts = stored.metadata() or {}
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118 (not a dict)
        if bad := [name for name, tensor in sorted(tensors.items()) if not is_finite(tensor)]:
            raise ValueError(f"NaN or inf in {', '.join(bad)}")
        step, groups = int(facts["step"]), json.loads(facts["groups"])
        return step, _part(tensors, MODEL), {"state": _moments(tensors), "param_groups": groups}
    except (safetensors.SafetensorError, OSError, ValueError, KeyError) as error:
        do = "Delete it to start the run again, or restore it from a copy."
        raise CheckpointError(expected(str(path), "a whole training state", repr(error)[:200], do)) from error


def _part(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _moments(tensors: dict[str, torch.Tensor]) -> dict[int, dict[str, torch.Tensor]]:
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for place, value in _part(tensors, MOMENTS).items():
        number, name = place.split(".", 1)
        moments.setdefault(int(number), {})[name] = value
    return moments
