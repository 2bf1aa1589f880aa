"""How fast a control loop can encode: two fingers per tick, references cached."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from uniforce_vtla.contact.pairs import equilibrium_pairs
from uniforce_vtla.tokenizer.api import Tokenizer


def bench_encode(seconds: float) -> dict[str, Any]:
    """Return ``encode_two_fingers_hz``: both fingers' 640×480 images to latents, one after the other."""
    tokenizer = Tokenizer.from_pretrained()
    pairs = equilibrium_pairs(np.random.default_rng(0), 8, "gelsight", "tactip")
    left, right = pairs.left_reference[:1], pairs.right_reference[:1]
    ticks, start = 0, 0.0
    while ticks == 0 or time.perf_counter() - start < seconds:
        i = ticks % 8
        tokenizer.encode(left, pairs.left_current[i : i + 1], "left")
        tokenizer.encode(right, pairs.right_current[i : i + 1], "right")
        if ticks == 0:  # the first tick fills the cache
            start = time.perf_counter()
        ticks += 1
    return {"encode_two_fingers_hz": (ticks - 1) / (time.perf_counter() - start)}
