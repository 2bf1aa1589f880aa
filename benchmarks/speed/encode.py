"""How fast a control loop can encode."""

import itertools
from typing import Any

import numpy as np

from benchmarks.timing import repeated
from uniforce_vtla.contact.pairs import equilibrium_pairs
from uniforce_vtla.tokenizer import Tokenizer


def bench_encode(seconds: float) -> dict[str, Any]:
    """Return ``encode_two_fingers_hz``: both fingers' 640×480 images to latents, one after the other."""
    tokenizer = Tokenizer.from_pretrained()
    pairs = equilibrium_pairs(np.random.default_rng(0), 8, "gelsight", "tactip")
    turns = itertools.cycle(range(8))

    def tick() -> None:
        i = next(turns)
        tokenizer.encode(pairs.left_reference[:1], pairs.left_current[i : i + 1], "left")
        tokenizer.encode(pairs.right_reference[:1], pairs.right_current[i : i + 1], "right")

    ticks, spent = repeated(tick, seconds)
    return {"encode_two_fingers_hz": ticks / spent}
