"""Size and speed of our encoder and of T3-medium's, side by side in one run."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
import torch
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.baselines.t3 import T3Encoder
from uniforce_vtla.contact.pairs import equilibrium_pairs
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import Encoder
from uniforce_vtla.tokenizer.settings import TokenizerConfig

OURS = "UniForce"


@dataclass(frozen=True)
class SpeedConfig:
    """How long to measure."""

    repeats: int = 5  # rounds; in each every encoder takes its turn, so that a busy machine slows all alike
    ours_per_round: int = 10  # ours is so much faster that one call is too short to time


@dataclass(frozen=True)
class Taken:
    """Time per frame of one turn: by the clock, and of the processor alone (which no other job lengthens)."""

    ms: float
    cpu_ms: float


@torch.no_grad()
def speed_report(
    tokenizer: Tokenizer, config: SpeedConfig | None = None, published: dict[str, T3Encoder] | None = None
) -> dict[str, Any]:
    """Return per encoder its size, ``ms_per_frame`` and ``cpu_ms_per_frame``, and both over ours.

    One 480×640 marker image to latents, resize included, one thread, batch 1, our reference cached. Weights are
    random: speed doesn't depend on what they are.

    Raises:
        ContractError: nothing to repeat.
    """
    config = config or SpeedConfig()
    if config.repeats < 1 or config.ours_per_round < 1:
        raise ContractError(expected("speed rounds", "at least 1", config, "Raise them."))
    published = {"T3-medium": T3Encoder()} if published is None else published
    reference, current = _images()
    turns = {OURS: _ours(tokenizer, reference, current, config.ours_per_round)}
    turns |= {name: _turn(encoder.eval(), current) for name, encoder in published.items()}
    with one_thread():
        taken = interleaved(turns, config.repeats)
    facts = {OURS: our_size(tokenizer)} | {name: size_facts(encoder) for name, encoder in published.items()}
    encoders = {name: facts[name] | _timing(taken, name) for name in turns}
    return {"what": "one marker image, one CPU thread, medians", "repeats": config.repeats, "encoders": encoders}


def our_size(tokenizer: Tokenizer) -> dict[str, Any]:
    """Return ``params`` of our encoder, ``flops_per_frame`` with the reference cached, and of the reference."""
    config: TokenizerConfig = tokenizer.config
    with torch.device("meta"):  # the counter doesn't know the CPU's fused attention
        encoder = Encoder(config)
        image = torch.empty(1, 1, config.side, config.side)
    with torch.no_grad():
        with FlopCounterMode(display=False) as once:
            cache = encoder.encode_reference(image)
        with FlopCounterMode(display=False) as each:
            encoder.encode_current(cache, image)
    return {
        "params": sum(p.numel() for p in tokenizer.model.encoder.parameters()),
        "flops_per_frame": int(each.get_total_flops()),
        "flops_per_reference": int(once.get_total_flops()),
        "input_px": [config.side, config.side],
    }


def size_facts(encoder: T3Encoder) -> dict[str, Any]:
    """Return ``params`` and ``flops_per_frame``, 2 per multiply-add.

    Counted on the meta device: the counter has no entry for the CPU's fused attention and would leave it out.
    """
    with torch.device("meta"):
        shadow, side = T3Encoder(encoder.config), encoder.config.image
        image = torch.empty(1, 3, side, side)
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        shadow.token_map(image)
    return {
        "params": sum(p.numel() for p in encoder.parameters()),
        "flops_per_frame": int(counter.get_total_flops()),
        "input_px": [side, side],
    }


def interleaved(turns: dict[str, Callable[[], int]], repeats: int) -> dict[str, list[Taken]]:
    """Return the times of every turn, round by round; a turn returns how many frames it took."""
    for turn in turns.values():
        turn()  # caches, memory
    taken: dict[str, list[Taken]] = {name: [] for name in turns}
    for _ in range(repeats):
        for name, turn in turns.items():
            start, cpu_start = time.perf_counter(), time.process_time()
            frames = turn()
            clock, cpu = time.perf_counter() - start, time.process_time() - cpu_start
            taken[name].append(Taken(1000 * clock / frames, 1000 * cpu / frames))
    return taken


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread within the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _timing(taken: dict[str, list[Taken]], name: str) -> dict[str, float]:
    """Return median times and the medians over rounds of their ratios to ours."""
    rounds = list(zip(taken[name], taken[OURS], strict=True))
    return {
        "ms_per_frame": median(theirs.ms for theirs, _ in rounds),
        "cpu_ms_per_frame": median(theirs.cpu_ms for theirs, _ in rounds),
        "times_ours": median(theirs.ms / ours.ms for theirs, ours in rounds),
        "cpu_times_ours": median(theirs.cpu_ms / ours.cpu_ms for theirs, ours in rounds),
    }


def _ours(tokenizer: Tokenizer, reference: np.ndarray, current: np.ndarray, frames: int) -> Callable[[], int]:
    def turn() -> int:
        for _ in range(frames):
            tokenizer.encode(reference, current)
        return frames

    return turn


def _turn(encoder: T3Encoder, current: np.ndarray) -> Callable[[], int]:
    images = torch.from_numpy(current)
    side = images.shape[-1]
    bar = (side - images.shape[-2]) // 2

    def turn() -> int:
        square = torch.nn.functional.pad(images.float() / 255, (0, 0, bar, bar))  # (1, 640, 640)
        encoder(square)
        return 1

    return turn


def _images() -> tuple[np.ndarray, np.ndarray]:
    """Return one reference and one contact image, (1, 480, 640) uint8."""
    pairs = equilibrium_pairs(np.random.default_rng(0), 1, "gelsight", "tactip")
    return pairs.left_reference[:1], pairs.left_current[:1]
