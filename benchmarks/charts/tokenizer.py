"""Tokenizers by size and precision: milliseconds for two fingers against zero-shot force on a frozen set."""

import copy
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from statistics import median
from typing import Any

import torch
from torch import nn

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.zero_shot import encode_set, score, summary, transfer_name
from benchmarks.timing import in_turns
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.weights import SIZES

PRECISIONS = ("float32", "bfloat16", "int8")
CALLS = 10  # of a turn: one alone is too short to time


def name_of(size: str, precision: str) -> str:
    return f"{size}, {precision}"


@contextmanager
def running_in(tokenizer: Tokenizer, precision: str) -> Iterator[Tokenizer]:
    """Let a tokenizer's encoder compute in another precision within the block; its latents stay float32.

    int8 is dynamic: weights of linear layers are rounded once, activations at each call.
    """
    whole = tokenizer.model.encoder
    if precision == "int8":
        with warnings.catch_warnings():  # torch moves this to torchao, which is one dependency more
            warnings.simplefilter("ignore", DeprecationWarning)
            rounded = torch.ao.quantization.quantize_dynamic(
                copy.deepcopy(whole), {nn.Linear}, dtype=torch.qint8
            )
        tokenizer.model.encoder = rounded
    try:
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bfloat16"):
            yield tokenizer
    finally:
        tokenizer.model.encoder = whole


def latencies_ms(labelled: LabelledSet, rounds: int) -> dict[str, float]:
    """Return milliseconds per look of two fingers, all points in turns; "…, no cache" encodes references anew."""
    calls: dict[str, Callable[[], None]] = {}
    for size in SIZES:
        for precision in PRECISIONS:
            calls[name_of(size, precision)] = _looks(
                Tokenizer.from_pretrained(size), precision, labelled
            )
        calls[f"{size}, no cache"] = _looks(
            Tokenizer.from_pretrained(size), "float32", labelled, cached=False
        )
    taken = in_turns(calls, rounds, _seconds)
    return {name: 1000 * median(times) / CALLS for name, times in taken.items()}


def _looks(
    tokenizer: Tokenizer, precision: str, labelled: LabelledSet, cached: bool = True
) -> Callable[[], None]:
    """Return a call that encodes a frame of two fingers ``CALLS`` times."""
    frames = labelled.frames[: CALLS + 1].reshape(-1, *labelled.frames.shape[2:])[: CALLS + 1]

    def call() -> None:
        with running_in(tokenizer, precision):
            for before, now in pairwise(frames):
                # more images than are remembered, each once per call, are encoded anew every time
                reference = labelled.reference[0] if cached else before
                for finger in FINGERS:
                    tokenizer.encode(reference, now[None], finger)

    return call


def _seconds(call: Callable[[], None]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def accuracies(frozen: dict[str, LabelledSet]) -> dict[str, dict[str, Any]]:
    """Return point → what a table's row says (``zero_shot.summary``) and R² of each cell, by the shipped heads."""
    found = {}
    for size in SIZES:
        for precision in PRECISIONS:
            with running_in(Tokenizer.from_pretrained(size), precision) as tokenizer:
                latents = {
                    name: encode_set(tokenizer, labelled).to(torch.float32)
                    for name, labelled in frozen.items()
                }
            found[name_of(size, precision)] = _accuracy(latents, size, frozen)
    return found


def _accuracy(
    latents: dict[str, torch.Tensor], size: str, frozen: dict[str, LabelledSet]
) -> dict[str, Any]:
    pairs = [(source, target) for source in frozen for target in frozen if source != target]
    heads = {source: ForceHead.from_pretrained(source, size) for source in frozen}
    cells = {
        transfer_name(a, b): score(frozen[b].force_N, heads[a].sequence(latents[b]).numpy())
        for a, b in pairs
    }
    return summary(cells) | {"cells": {name: cell["r2"] for name, cell in cells.items()}}
