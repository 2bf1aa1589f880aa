"""A text tokenizer's files as tensors, so that a preprocessor's own state file carries it.

LeRobot's pipelines store a tokenizer by name. A folder's name is gone on the next machine, and PaliGemma's needs an
account that accepted its terms; a state file moves with the checkpoint, to the hub too.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import Tensor
from transformers import AutoTokenizer

SAVED = "saved:text_tokenizer"  # the name a preprocessor stores for a tokenizer in its state file


def to_tensors(tokenizer: Any) -> dict[str, Tensor]:
    """Return file name → the file's bytes, (n,) uint8."""
    with TemporaryDirectory() as folder:
        tokenizer.save_pretrained(folder)
        files = sorted(path for path in Path(folder).iterdir() if path.is_file())
        return {
            path.name: torch.frombuffer(bytearray(path.read_bytes()), dtype=torch.uint8) for path in files
        }


def from_tensors(files: dict[str, Tensor]) -> Any:
    """Return the tokenizer whose files these are; nothing is looked for anywhere else."""
    with TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / Path(name).name).write_bytes(content.cpu().numpy().tobytes())
        return AutoTokenizer.from_pretrained(folder, local_files_only=True)
