"""Strict loading: a checkpoint either fits tensor by tensor, or an error says which tensor doesn't."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from huggingface_hub import hf_hub_download
from huggingface_hub.errors import HfHubHTTPError
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from uniforce_vtla.errors import CheckpointError, expected

WEIGHTS = "model.safetensors"
CONFIG = "config.json"


def find(source: str | Path, name: str, revision: str | None = None, local_files_only: bool = False) -> Path:
    """Return the path of one file of a checkpoint folder or hub repository.

    Raises:
        CheckpointError: there is no such file.
    """
    if Path(source).is_dir() or Path(source).is_absolute():
        path = Path(source) / name
        if not path.is_file():
            raise CheckpointError(
                expected(str(path), "a file", "none", "Point at a pretrained_model folder.")
            )
        return path
    try:
        return Path(hf_hub_download(str(source), name, revision=revision, local_files_only=local_files_only))
    except (HfHubHTTPError, OSError) as error:
        raise CheckpointError(
            expected(f"{source}/{name}", "a folder or hub repository", error, "Check path and network.")
        ) from error


def read_config(path: Path) -> dict[str, Any]:
    """Return the saved settings.

    Raises:
        CheckpointError: the file is not JSON.
    """
    try:
        return json.loads(path.read_text())
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise CheckpointError(
            expected(str(path), "JSON", error, "The file is cut or damaged; copy it again.")
        ) from error


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Return every tensor of a safetensors file.

    Raises:
        CheckpointError: the file is truncated or damaged.
    """
    try:
        return load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise CheckpointError(
            expected(str(path), "a whole safetensors file", error, "It is cut or damaged; copy it again.")
        ) from error


def load_strict(module: nn.Module, tensors: dict[str, Tensor]) -> None:
    """Copy ``tensors`` into ``module``; nothing may be missing, left over or of another shape.

    Raises:
        CheckpointError: naming the first tensors that don't fit.
    """
    own = module.state_dict()
    problems = {
        "missing": sorted(own.keys() - tensors.keys()),
        "unexpected": sorted(tensors.keys() - own.keys()),
        "misshapen": sorted(k for k in own.keys() & tensors.keys() if own[k].shape != tensors[k].shape),
    }
    found = {kind: _shorten(names) for kind, names in problems.items() if names}
    if found:
        do = "Load it with the settings it was trained with (its own config.json)."
        raise CheckpointError(expected("checkpoint tensors", f"the {len(own)} of this policy", found, do))
    module.load_state_dict(tensors, strict=True)


def _shorten(names: list[str], most: int = 5) -> str:
    rest = f" … and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + rest
