"""The small text tokenizer that ships with the package: bytes, state bins and common words; no hub, no corpus."""

from __future__ import annotations

from pathlib import Path

from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors
from transformers import PreTrainedTokenizerFast

FOLDER = Path(__file__).parent / "text_tokenizer"
PACKAGED = "packaged:text_tokenizer"  # what checkpoints store, so that a moved installation still loads
PALIGEMMA = "google/paligemma-3b-pt-224"  # the vocabulary of the published π0.5 weights

SPECIAL = ["<pad>", "<eos>", "<bos>", "<unk>"]
PROMPT = ["Task:", ", State:", ";\nAction:"]  # the fixed text of π0.5's prompt, one token each
WORDS = (
    "a all and at away board clean down dry eraser erase firmly force from gently grasp gripper hand hold ink "
    "into it lift mark marker move of off on over pick place press put residue robot slide slowly strokes surface "
    "table the then to tool until up whiteboard wipe with without writing Wipe Clean Erase Pick Grasp Use"
)


def resolve(name: str | None, size: str) -> str:
    """Return the tokenizer name to store: the packaged one for tiny, PaliGemma's for base, unless one is given."""
    return name or (PACKAGED if size == "tiny" else PALIGEMMA)


def location(name: str) -> str:
    """Return where a stored name loads from on this machine."""
    return str(FOLDER) if name == PACKAGED else name


def vocabulary_size() -> int:
    """Return the number of ids the packaged tokenizer can produce."""
    return len(SPECIAL) + 256 + len(PROMPT) + 257 + len(WORDS.split())


def build(folder: Path) -> None:
    """Write the tokenizer's files: one token per byte, per state bin (−1…255), per prompt part, per known word."""
    vocabulary = {t: i for i, t in enumerate([*SPECIAL, *sorted(pre_tokenizers.ByteLevel.alphabet())])}
    tokenizer = Tokenizer(models.BPE(vocab=vocabulary, merges=[], unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    bins = [f" {i}" for i in range(-1, 256)]
    tokenizer.add_tokens([*PROMPT, *bins, *(f" {word}" for word in WORDS.split())])
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<bos> $A", special_tokens=[("<bos>", vocabulary["<bos>"])]
    )
    PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, pad_token="<pad>", eos_token="<eos>", bos_token="<bos>", unk_token="<unk>"
    ).save_pretrained(folder)
