"""Checkpoints: a folder with ``model.safetensors`` and ``config.json``, loaded strictly.

A training run's state (weights, optimiser, step) is safetensors too: resuming unpickles nothing.
"""

import hashlib
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import safetensors
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.file_hashes import check_hashes, drop_hashes, write_hashes
from uniforce_vtla.json_file import read_object
from uniforce_vtla.results_file import PROVENANCE, provenance, write_json

WEIGHTS = "model.safetensors"
CONFIG = "config.json"
ASSETS = Path(__file__).parent / "assets"  # checkpoints that come with the package
DEFAULT_SIZE = "small"
SIZES = (DEFAULT_SIZE, "nano")  # one folder each: tokenizer/ and force_head_SENSOR/


def checkpoint_folder(path: str | Path | None, part: str) -> Path:
    """Return ``path``, or the shipped ``part`` of the size it names (None: the default size)."""
    size = DEFAULT_SIZE if path is None else str(path)
    if size in SIZES:
        return ASSETS / size / part
    return Path(size)


def save_checkpoint(folder: Path, model: nn.Module, config: dict[str, Any]) -> Path:
    """Write weights, ``config`` and provenance atomically, file by file, and last their hashes."""
    folder.mkdir(parents=True, exist_ok=True)
    drop_hashes(folder)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        save_file(_stored(model.state_dict()), Path(scratch) / WEIGHTS)
        (Path(scratch) / CONFIG).write_text(json.dumps(config, indent=1, sort_keys=True) + "\n")
        for name in (WEIGHTS, CONFIG):
            # safetensors makes them private; a package is for everyone
            (Path(scratch) / name).chmod(0o644)
            (Path(scratch) / name).replace(folder / name)
    write_json(folder / PROVENANCE, provenance())
    write_hashes(folder, (WEIGHTS, CONFIG, PROVENANCE))
    return folder


def _stored(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return tensors as safetensors takes them."""
    return {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}


def read_config(folder: Path) -> dict[str, Any]:
    """Return the checkpoint's config, its files compared with their hashes.

    Raises CheckpointError: no such checkpoint, a changed file, or a config that isn't JSON.
    """
    path = folder / CONFIG
    if not path.is_file() or not (folder / WEIGHTS).is_file():
        raise CheckpointError(
            expected("checkpoint", f"{WEIGHTS} and {CONFIG} in {folder}", "none", "Check the path.")
        )
    check_hashes(folder, CheckpointError)
    return read_object(path, CheckpointError)


def load_model[Model: nn.Module](folder: Path, build: Callable[[], Model]) -> Model:
    """Return what ``build`` makes, with the checkpoint's tensors.

    It is built without memory first: sizes that don't fit the file cost nothing.

    Raises CheckpointError: truncated, or any tensor missing, unexpected, of another shape or type,
    or not finite; all are listed.
    """
    try:
        tensors = load_file(folder / WEIGHTS)
    except (safetensors.SafetensorError, OSError, ValueError, KeyError) as error:
        do = "Copy the checkpoint again."
        raise CheckpointError(
            expected(str(folder / WEIGHTS), "readable weights", str(error), do)
        ) from error
    with torch.device("meta"):
        wanted = build().state_dict()
    wrong = mismatches(wanted, tensors)
    for name in sorted(tensors):
        if not is_finite(tensors[name]):
            wrong.append(f"NaN or inf in {name}")
    if wrong:
        do = "Load the config it was made with."
        raise CheckpointError(expected(str(folder), "the model's tensors", "; ".join(wrong), do))
    model = build()
    model.load_state_dict(tensors)
    return model


def is_finite(tensor: torch.Tensor) -> bool:
    """Return whether a tensor holds no NaN and no inf; one pass, no copy."""
    if not tensor.is_floating_point() or not tensor.numel():
        return True
    return bool(torch.stack(torch.aminmax(tensor)).isfinite().all())


def mismatches(wanted: dict[str, torch.Tensor], came: dict[str, torch.Tensor]) -> list[str]:
    """Return a line for every tensor that is missing, unexpected, or of another shape or type."""
    lines = [f"missing {name}" for name in sorted(wanted.keys() - came.keys())]
    lines += [f"unexpected {name}" for name in sorted(came.keys() - wanted.keys())]
    for name in sorted(wanted.keys() & came.keys()):
        if wanted[name].shape != came[name].shape:
            lines.append(f"{name} is {tuple(came[name].shape)}, not {tuple(wanted[name].shape)}")
        if wanted[name].dtype != came[name].dtype:
            lines.append(f"{name} is {came[name].dtype}, not {wanted[name].dtype}")
    return lines


def content_hash(model: nn.Module, facts: dict[str, Any]) -> str:
    """Return the sha256 of all tensors (name, type, shape, bytes) and of ``facts`` as JSON."""
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for name, value in sorted(model.state_dict().items()):
        array = value.detach().cpu().contiguous().numpy()
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


STATE = "state.safetensors"
MODEL = "model."
MOMENTS = "optimizer."


def save_state(folder: Path, step: int, model: dict[str, Any], optimizer: dict[str, Any]) -> Path:
    """Write both state dicts atomically."""
    tensors = {MODEL + name: value for name, value in model.items()}
    for number, moments in optimizer["state"].items():
        for name, value in moments.items():
            tensors[f"{MOMENTS}{number}.{name}"] = torch.as_tensor(value)
    facts = {"step": str(step), "groups": json.dumps(optimizer["param_groups"])}
    scratch = folder / "state.tmp"
    save_file(_stored(tensors), scratch, metadata=facts)
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
        tensors = load_file(path)
        if bad := [name for name in sorted(tensors) if not is_finite(tensors[name])]:
            raise ValueError(f"NaN or inf in {', '.join(bad)}")
        step = int(facts["step"])
        moments = {"state": _moments(tensors), "param_groups": json.loads(facts["groups"])}
        return step, _part(tensors, MODEL), moments
    except (safetensors.SafetensorError, OSError, ValueError, KeyError) as error:
        do = "Delete it to start the run again, or restore it from a copy."
        raise CheckpointError(
            expected(str(path), "a whole training state", repr(error)[:200], do)
        ) from error


def _part(tensors: dict[str, torch.Tensor], prefix: str) -> dict[str, torch.Tensor]:
    return {
        name.removeprefix(prefix): value
        for name, value in tensors.items()
        if name.startswith(prefix)
    }


def _moments(tensors: dict[str, torch.Tensor]) -> dict[int, dict[str, torch.Tensor]]:
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for place, value in _part(tensors, MOMENTS).items():
        number, name = place.split(".", 1)
        moments.setdefault(int(number), {})[name] = value
    return moments
