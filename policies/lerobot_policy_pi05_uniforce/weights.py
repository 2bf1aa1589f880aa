"""Load weights strictly, tensor by tensor; understand a published π0.5's names."""

from collections.abc import Callable, Collection, Iterable, Iterator
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
from uniforce_vtla.tokenizer.weights import is_finite

ALIGNED_BELOW = 2**20  # bytes: all of tiny's matrices, hardly anything of base
WEIGHTS = "model.safetensors"
CONFIG = "config.json"
# start fresh whatever the source had
TOUCH = ("model.force_tokens.", "model.touch_gate.", "model.tactile_encoder.")
FRESH = (*TOUCH, "model.state_token.")  # no other checkpoint has them
BACKBONE = "model.paligemma_with_expert."
EMBEDDING = f"{BACKBONE}paligemma.model.language_model.embed_tokens.weight"
HEADS = (f"{BACKBONE}paligemma.lm_head.weight", f"{BACKBONE}gemma_expert.lm_head.weight")


def find(
    source: str | Path, name: str, revision: str | None = None, local_files_only: bool = False
) -> Path:
    """Return the path of one file of a checkpoint folder or hub repository.

    Raises CheckpointError: there is no such file.
    """
    if Path(source).is_dir() or Path(source).is_absolute():
        path = Path(source) / name
        if not path.is_file():
            do = "Point at a pretrained_model folder."
            raise CheckpointError(expected(str(path), "a file", "none", do))
        return path
    try:
        return Path(
            hf_hub_download(str(source), name, revision=revision, local_files_only=local_files_only)
        )
    except (HfHubHTTPError, OSError) as error:
        wanted = "a folder or hub repository"
        do = "Check path and network."
        raise CheckpointError(expected(f"{source}/{name}", wanted, error, do)) from error


def check_files(
    source: str | Path, verify: str, revision: str | None, local_files_only: bool
) -> None:
    """Compare every file of a checkpoint with its hash, fetching those of a hub repository.

    Raises CheckpointError: a file that is missing, changed or without a hash.
    """
    folder = find(source, CONFIG, revision, local_files_only).parent
    with suppress(CheckpointError):  # a checkpoint without hashes: ``check_hashes`` says so
        folder = find(source, HASHES, revision, local_files_only).parent
    if not Path(source).is_dir():
        for name in hashed_names(folder, CheckpointError):
            find(source, name, revision, local_files_only)
    check_hashes(folder, CheckpointError, verify)


def same_names(stored: Iterable[str]) -> dict[str, str]:
    """Return each name as it is stored."""
    return {name: name for name in stored}


def fill(
    module: nn.Module,
    path: Path,
    rename: Callable[[Iterable[str]], dict[str, str]] = same_names,
    fresh: tuple[str, ...] = (),
) -> None:
    """Put a safetensors file's tensors into ``module``, which may be empty (``no_weights``).

    Peak memory is the weights and little more. Nothing may be missing, left over or misshapen.

    Args:
        module: takes each tensor in its own dtype and, unless empty, on its own device.
        path: the file.
        rename: stored names → stored name: name in ``module``; what isn't in it isn't wanted.
        fresh: prefixes of names that may be missing: modules the file's author didn't have.

    Raises CheckpointError: a damaged file, or naming the tensors that don't fit or aren't finite.
    """
    tensors = {}
    with opened(path) as stored:
        for name, own in rename(stored.keys()).items():
            tensors[own] = stored.get_tensor(name)
    wanted = module.state_dict()
    _check(wanted, tensors, fresh)
    for name, tensor in tensors.items():
        check_finite(tensor, f"{name} of {path}")
        # A copy has aligned memory. In the file a tensor may start anywhere, and a matrix product's
        # last bits depend on that. Large ones stay mapped: base must never be held twice.
        copy = tensor.nbytes < ALIGNED_BELOW
        device = tensor.device if wanted[name].is_meta else wanted[name].device
        tensors[name] = tensor.to(device, wanted[name].dtype, copy=copy)
    module.load_state_dict(tensors, strict=False, assign=True)


def check_finite(tensor: Tensor, name: str) -> None:
    """Raise CheckpointError if a tensor holds NaN or inf."""
    if not is_finite(tensor):
        do = "Copy the checkpoint again."
        raise CheckpointError(expected(name, "finite numbers", "NaN or inf", do))


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a safetensors file; raise CheckpointError where it is truncated or damaged."""
    try:
        with safe_open(path, framework="pt") as stored:
            yield stored
    except (SafetensorError, OSError, ValueError) as error:
        do = "It is cut or damaged; copy it again."
        raise CheckpointError(expected(str(path), "a whole safetensors file", error, do)) from error


def no_weights() -> AbstractContextManager:
    """Return a context in which modules get no memory for parameters; ``fill`` gives it."""
    return init_empty_weights(include_buffers=False)


def _check(own: dict[str, Tensor], stored: dict[str, Tensor], fresh: tuple[str, ...]) -> None:
    missing = [name for name in own.keys() - stored.keys() if not name.startswith(fresh)]
    misshapen = []
    for name in own.keys() & stored.keys():
        if own[name].shape != stored[name].shape:
            misshapen.append(name)
    found = [
        *_counted("missing", missing),
        *_counted("unexpected", stored.keys() - own.keys()),
        *_counted("misshapen", misshapen),
    ]
    if found:
        wanted = f"the {len(own)} of this policy"
        do = "Load it with the settings it was trained with (its own config.json)."
        raise CheckpointError(expected("checkpoint tensors", wanted, ", ".join(found), do))


def _counted(problem: str, names: Collection[str]) -> Iterator[str]:
    if names:
        more = " …" if len(names) > 1 else ""
        yield f"{len(names)} {problem} ({min(names)}{more})"


def own_names(stored: Iterable[str]) -> dict[str, str]:
    """Return stored name → ours; what isn't in the result isn't wanted.

    Both language heads are left out, since nothing reads them, and so is a pi05_uniforce's touch.
    Where a file stores the tied input embedding as the VLM's head, it is taken from there. openpi's
    names of the time MLP are understood. A strange name stays and makes ``fill`` raise.
    """
    ours = {}
    tied = ""
    for name in stored:
        full = name if name.startswith("model.") else f"model.{name}"
        if full == HEADS[0]:
            tied = name
        if not full.startswith((*HEADS, *TOUCH)):
            ours[name] = full.replace("model.action_time_mlp_", "model.time_mlp_")
    if tied and EMBEDDING not in ours.values():
        ours[tied] = EMBEDDING
    return ours
