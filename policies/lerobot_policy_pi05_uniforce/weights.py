"""Strict loading: a checkpoint either fits tensor by tensor, or an error says which tensor doesn't."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from accelerate import init_empty_weights
from huggingface_hub import hf_hub_download
from huggingface_hub.errors import HfHubHTTPError
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.file_hashes import HASHES, check_hashes, hashed_names
from uniforce_vtla.json_file import read_object
from uniforce_vtla.tokenizer.weights import is_finite

ALIGNED_BELOW = 2**20  # bytes: all of tiny's matrices, hardly anything of base
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
        CheckpointError: the file is no JSON object.
    """
    return read_object(path, CheckpointError)


def check_files(source: str | Path, verify: str, revision: str | None, local_files_only: bool) -> None:
    """Compare every file of a checkpoint folder or hub repository with its hash, fetching those of a repository.

    Raises:
        CheckpointError: a file that is missing, changed or without a hash.
    """
    folder = find(source, CONFIG, revision, local_files_only).parent
    with suppress(CheckpointError):  # a checkpoint without hashes: ``check_hashes`` says so
        folder = find(source, HASHES, revision, local_files_only).parent
    if not Path(source).is_dir():
        for name in hashed_names(folder, CheckpointError):
            find(source, name, revision, local_files_only)
    check_hashes(folder, CheckpointError, verify)


def fill(
    module: nn.Module,
    path: Path,
    rename: Callable[[str], str | None] = lambda name: name,
    fresh: tuple[str, ...] = (),
) -> None:
    """Put a safetensors file's tensors into ``module``, which may be empty (``no_weights``), one after another.

    Peak memory is the weights and one tensor more. Nothing may be missing, left over or of another shape.

    Args:
        module: takes each tensor in its own dtype and, unless empty, on its own device.
        path: the file.
        rename: stored name → name in ``module``, or None for what isn't wanted.
        fresh: prefixes of names that may be missing: modules the file's author didn't have.

    Raises:
        CheckpointError: a truncated or damaged file, or naming the tensors that don't fit or hold NaN or inf.
    """
    with opened(path) as stored:
        renamed = ((rename(name), name) for name in stored.keys())  # noqa: SIM118 (not a dict)
        placed = {own: name for own, name in renamed if own is not None}
        shapes = {own: tuple(stored.get_slice(name).get_shape()) for own, name in placed.items()}
        _check(module, shapes, fresh)
        for own, name in placed.items():
            _place(module, own, finite(stored.get_tensor(name), f"{name} of {path}"))


def finite(tensor: Tensor, what: str) -> Tensor:
    """Return ``tensor``; raise CheckpointError if it holds NaN or inf."""
    if not is_finite(tensor):
        raise CheckpointError(expected(what, "finite numbers", "NaN or inf", "Copy the checkpoint again."))
    return tensor


def names(path: Path) -> list[str]:
    """Return the names in a safetensors file.

    Raises:
        CheckpointError: the file is truncated or damaged.
    """
    with opened(path) as stored:
        return list(stored.keys())


@contextmanager
def opened(path: Path, what: str = "weights") -> Iterator[Any]:
    """Open a safetensors file; raise CheckpointError where it is truncated or damaged."""
    try:
        with safe_open(path, framework="pt") as stored:
            yield stored
    except (SafetensorError, OSError, ValueError) as error:
        raise CheckpointError(
            expected(
                f"{what} in {path}", "a whole safetensors file", error, "It is cut or damaged; copy it again."
            )
        ) from error


def no_weights() -> AbstractContextManager:
    """Return a context in which modules are built without memory for their parameters; ``fill`` gives it."""
    return init_empty_weights(include_buffers=False)


def _check(module: nn.Module, shapes: dict[str, tuple[int, ...]], fresh: tuple[str, ...]) -> None:
    own = {name: tuple(tensor.shape) for name, tensor in module.state_dict().items()}
    problems = {
        "missing": sorted(n for n in own.keys() - shapes.keys() if not n.startswith(fresh)),
        "unexpected": sorted(shapes.keys() - own.keys()),
        "misshapen": sorted(k for k in own.keys() & shapes.keys() if own[k] != shapes[k]),
    }
    found = {kind: ", ".join(names) for kind, names in problems.items() if names}
    if found:
        do = "Load it with the settings it was trained with (its own config.json)."
        raise CheckpointError(expected("checkpoint tensors", f"the {len(own)} of this policy", found, do))


def _place(module: nn.Module, name: str, tensor: Tensor) -> None:
    parent, _, leaf = name.rpartition(".")
    owner = module.get_submodule(parent)
    old = getattr(owner, leaf)
    device = tensor.device if old.is_meta else old.device
    # A copy has aligned memory; in the file a tensor may start anywhere, and a matrix product's last bits hang on that.
    # Large ones stay mapped from the file: base must never be held twice.
    new = tensor.to(device, old.dtype, copy=tensor.nbytes < ALIGNED_BELOW)
    if isinstance(old, nn.Parameter):
        owner.register_parameter(leaf, nn.Parameter(new, requires_grad=old.requires_grad))
    else:
        owner.register_buffer(leaf, new)
