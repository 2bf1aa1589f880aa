"""How fast a control loop can encode, what the reference cache buys, and whether an hour of frames leaks memory."""

import itertools
import time
from typing import Any

import numpy as np
import psutil
import torch

from benchmarks.timing import repeated
from uniforce_vtla.contact.pairs import PairBatch, equilibrium_pairs
from uniforce_vtla.tokenizer import ForceHead, Tokenizer
from uniforce_vtla.tokenizer.entry import prepare
from uniforce_vtla.tokenizer.streaming import StreamingEncoder

SETTLING_FRAMES = 500  # allocators fill their pools first; memory is compared with what is held after these


def bench_encode(seconds: float) -> dict[str, Any]:
    """Return ``encode_two_fingers_hz``: both fingers' 640×480 images to latents, one after the other."""
    tokenizer, pairs = Tokenizer.from_pretrained(), _pairs()
    turns = itertools.cycle(range(8))

    def tick() -> None:
        i = next(turns)
        tokenizer.encode(pairs.left_reference[:1], pairs.left_current[i : i + 1], "left")
        tokenizer.encode(pairs.right_reference[:1], pairs.right_current[i : i + 1], "right")

    ticks, spent = repeated(tick, seconds)
    return {"encode_two_fingers_hz": ticks / spent}


@torch.no_grad()
def bench_cached(seconds: float) -> dict[str, Any]:
    """Return how much faster prepared images are encoded with a cached reference, and how far the answers differ."""
    tokenizer, pairs = Tokenizer.from_pretrained(), _pairs()
    encoder, side = tokenizer.model.encoder, tokenizer.config.side
    reference = prepare(pairs.left_reference[:1], "left", side, "reference")
    currents = prepare(pairs.left_current, "left", side, "current")
    cache = encoder.encode_reference(reference)
    took: dict[str, list[float]] = {"full": [], "cached": []}
    difference, end = 0.0, time.perf_counter() + seconds
    for i in itertools.count():
        current = currents[i % 8 : i % 8 + 1]
        begin = time.perf_counter()
        full = encoder(reference, current).mean
        middle = time.perf_counter()
        cached = encoder.encode_current(cache, current).mean
        done = time.perf_counter()
        took["full"].append(middle - begin)
        took["cached"].append(done - middle)
        difference = max(difference, float((full - cached).abs().max()))
        if done > end and i >= 8:
            break
    ratio = float(np.median(took["full"]) / np.median(took["cached"]))
    return {"cached_times_faster": ratio, "cached_max_abs_difference": difference}


def bench_stream(seconds: float) -> dict[str, Any]:
    """Return how many frames a streaming encoder with its head answered, how fast, and how its memory grew.

    An hour at 30 Hz is 108,000 frames: ask for some ten minutes.
    """
    tokenizer, pairs = Tokenizer.from_pretrained(), _pairs()
    stream = StreamingEncoder(tokenizer, "left", ForceHead.from_pretrained("gelsight"))
    stream.set_reference(pairs.left_reference[0])
    process = psutil.Process()
    frames, settled, end = 0, 0, float("inf")
    while time.perf_counter() < end:
        stream.step(pairs.left_current[frames % 8])
        frames += 1
        if frames == SETTLING_FRAMES:
            settled, start = process.memory_info().rss, time.perf_counter()
            end = start + seconds
    counted = frames - SETTLING_FRAMES
    found = {
        "frames": counted,
        "hours_at_30_hz": counted / 108_000,
        "hz": counted / (time.perf_counter() - start),
        "grown_MB": (process.memory_info().rss - settled) / 1e6,
    }
    return {"stream": found}


def _pairs() -> PairBatch:
    return equilibrium_pairs(np.random.default_rng(0), 8, "gelsight", "tactip")
