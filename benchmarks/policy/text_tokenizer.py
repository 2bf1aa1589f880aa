"""How the packaged text tokenizer was made: ``python -m benchmarks.policy.text_tokenizer FOLDER``."""

import sys
from pathlib import Path

from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors
from transformers import PreTrainedTokenizerFast

SPECIAL = ["<pad>", "<eos>", "<bos>", "<unk>"]
PROMPT = ["Task:", ", State:", ";\nAction:"]  # the fixed text of π0.5's prompt, one token each
WORDS = (
    "a all and at away board clean down dry eraser erase firmly force from gently grasp gripper hand hold ink "
    "into it lift mark marker move of off on over pick place press put residue robot slide slowly strokes surface "
    "table the then to tool until up whiteboard wipe with without writing Wipe Clean Erase Pick Grasp Use"
)


def build(folder: Path) -> None:
    """Write the packaged tokenizer's files: one token per byte, per state bin (−1…255), per prompt part, per word."""
    vocabulary = {
        t: i for i, t in enumerate([*SPECIAL, *sorted(pre_tokenizers.ByteLevel.alphabet())])
    }
    tokenizer = Tokenizer(models.BPE(vocab=vocabulary, merges=[], unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    bins = [f" {i}" for i in range(-1, 256)]
    tokenizer.add_tokens([*PROMPT, *bins, *(f" {word}" for word in WORDS.split())])
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<bos> $A", special_tokens=[("<bos>", vocabulary["<bos>"])]
    )
    PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        pad_token="<pad>",
        eos_token="<eos>",
        bos_token="<bos>",
        unk_token="<unk>",
    ).save_pretrained(folder)


if __name__ == "__main__":
    build(Path(sys.argv[1]))
