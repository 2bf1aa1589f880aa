"""The text tokenizer: a small one that ships with the package, or any other, stored with the preprocessor."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from lerobot.processor import ProcessorStepRegistry, TokenizerProcessorStep
from torch import Tensor
from transformers import AutoTokenizer

from uniforce_vtla.errors import CheckpointError, expected

logger = logging.getLogger(__name__)

FOLDER = Path(__file__).parent / "text_tokenizer"
PACKAGED = "packaged:text_tokenizer"  # what checkpoints store, so that a moved installation still loads
SAVED = "saved:text_tokenizer"  # likewise, for a tokenizer in the preprocessor's own state file
VOCABULARY = 640  # ids for the packaged one's tokens and the image token, rounded up to 64
PALIGEMMA = "google/paligemma-3b-pt-224"  # the vocabulary of the published π0.5 weights


def resolve(name: str | None, size: str) -> str:
    """Return the tokenizer name to store: the packaged one for tiny, PaliGemma's for base, unless one is given."""
    return name or (PACKAGED if size == "tiny" else PALIGEMMA)


@ProcessorStepRegistry.register(name="uniforce_tokenizer_processor")
@dataclass
class UniforceTokenizerProcessorStep(TokenizerProcessorStep):
    """Tokenize the prompt, with nothing but the checkpoint at hand.

    LeRobot stores a tokenizer by name; a folder's is gone on the next machine, and PaliGemma's needs an account. So the
    packaged one is found wherever the package is installed, and any other is saved whole, as this step's state.
    """

    tokenizer_name: str | None = PACKAGED

    def __post_init__(self) -> None:
        self._files: dict[str, Tensor] = {}
        self._warned = False
        if self.tokenizer_name == SAVED:
            return  # load_state_dict brings it
        stored = self.tokenizer_name or PACKAGED
        self.tokenizer_name = str(FOLDER) if stored == PACKAGED else stored
        super().__post_init__()
        self.tokenizer_name = stored

    @property
    def _packaged(self) -> bool:
        return self.tokenizer_name == PACKAGED

    def get_config(self) -> dict[str, Any]:
        """Return what the pipeline's JSON holds."""
        return {**super().get_config(), "tokenizer_name": PACKAGED if self._packaged else SAVED}

    def state_dict(self) -> dict[str, Tensor]:
        """Return the tokenizer's files as (n,) uint8; nothing for the packaged one."""
        if not self._packaged and not self._files:
            self._files = _to_tensors(self.input_tokenizer)
        return dict(self._files)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take the tokenizer from its files; nothing is looked for anywhere else."""
        self._files = dict(state)
        with TemporaryDirectory() as folder:
            for name, content in state.items():
                (Path(folder) / Path(name).name).write_bytes(content.cpu().numpy().tobytes())
            self.input_tokenizer = AutoTokenizer.from_pretrained(folder, local_files_only=True)

    def _tokenize_text(self, text: str | list[str]) -> dict[str, Tensor]:
        if self.input_tokenizer is None:
            do = "Copy the checkpoint again, with every file of its preprocessor."
            raise CheckpointError(expected("text tokenizer", "its files in the preprocessor", "none", do))
        tokens = super()._tokenize_text(text)
        if not self._warned and bool(tokens["attention_mask"].all(dim=-1).any()):
            self._warned = True
            logger.warning("A prompt fills all %d text tokens; its end may be cut: %r", self.max_length, text)
        return tokens


def _to_tensors(tokenizer: Any) -> dict[str, Tensor]:
    with TemporaryDirectory() as folder:
        tokenizer.save_pretrained(folder)
        files = sorted(path for path in Path(folder).iterdir() if path.is_file())
        return {
            path.name: torch.frombuffer(bytearray(path.read_bytes()), dtype=torch.uint8) for path in files
        }
