"""Foreign checkpoints: read without running their code, loaded by strict key match."""

import argparse
from pathlib import Path
from pickle import UnpicklingError

import torch
from torch import nn

from uniforce_vtla.errors import CheckpointError, expected
from uniforce_vtla.tokenizer.weights import is_finite, mismatches

DAMAGE = (
    *(UnpicklingError, RuntimeError, EOFError, OSError, ValueError, TypeError, KeyError, IndexError),
    *(AttributeError, AssertionError, ArithmeticError),
)  # what torch raises over damaged files
Tensors = dict[str, torch.Tensor]


def read_tensors(path: Path, inside: str | None = None) -> Tensors:
    """Return the state dict in a ``torch.save`` file, or the one under its key ``inside``.

    Only tensors and plain containers are unpickled. Trainers also leave their command line in the file as an
    ``argparse.Namespace``, which runs nothing and is let through.

    Raises:
        CheckpointError: missing, unreadable, with other objects inside, or without ``inside``.
    """
    if not path.is_file():
        raise CheckpointError(expected("weights", "a file", path, "Download it from its authors' page."))
    try:
        with torch.serialization.safe_globals([argparse.Namespace]):
            content = torch.load(path, map_location="cpu", weights_only=True)
    except DAMAGE as error:
        raise CheckpointError(
            expected(str(path), "tensors only", error, "Copy it again, or re-save only its state dict elsewhere.")
        ) from error
    if inside is not None and isinstance(content, dict):
        content = content.get(inside)
    if not isinstance(content, dict) or not all(isinstance(v, torch.Tensor) for v in content.values()):
        where = f"name → tensor under {inside!r}" if inside else "name → tensor"
        raise CheckpointError(expected(str(path), where, type(content).__name__, "Is this the right file?"))
    return content


def load_strictly(module: nn.Module, tensors: Tensors, name: str) -> None:
    """Copy ``tensors`` into ``module``.

    Raises:
        CheckpointError: any tensor missing, unexpected, of another shape or not finite; every one is named.
    """
    wrong = mismatches(module.state_dict(), tensors)
    wrong += [f"NaN or inf in {key}" for key, tensor in sorted(tensors.items()) if not is_finite(tensor)]
    if wrong:
        raise CheckpointError(
            expected(name, "exactly the encoder's tensors", "; ".join(wrong), "Is it another size or release?")
        )
    module.load_state_dict(tensors)
