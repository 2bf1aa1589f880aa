"""Size and speed of our encoder and of T3-medium's, side by side in one run."""

import time
from collections.abc import Callable
from statistics import median
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F  # noqa: N812
from torch.utils.flop_counter import FlopCounterMode
from transformers import ViTConfig, ViTModel

from benchmarks.probes.zero_shot import POOL
from benchmarks.timing import in_turns, ratio
from uniforce_cli.boundary import one_thread
from uniforce_vtla.contact.pairs import equilibrium_pairs
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import Encoder

OURS = "UniForce"
RESIZE = 256 / 224  # T3's pictures: shorter edge before the centre crop, over the side after it


class T3Encoder(nn.Module):
    """T3-medium (Transferable Tactile Transformer, alanzjl/t3, MIT) by its published sizes, those of ViT-B/16.

    A sensor's encoder has 3 plain ViT blocks, the shared trunk 9. For its speed alone, with random weights: the
    official ones were never at hand, and time depends on shapes alone.
    """

    def __init__(self, config: ViTConfig | None = None) -> None:
        super().__init__()
        self.vit = ViTModel(config or ViTConfig(), add_pooling_layer=False)
        self.config = self.vit.config

    def token_map(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the trunk's patch tokens (B, D, 14, 14), at full size, of (B, 3, 224, 224)."""
        tokens = self.vit(inputs).last_hidden_state[:, 1:]  # (B, P, D)
        side = self.config.image_size // self.config.patch_size
        return tokens.transpose(1, 2).unflatten(2, (side, side))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return (B, POOL², D) of grey images (B, S, S) in [0, 1]: resized, cropped, the tokens pooled as ours are."""
        side = self.config.image_size
        larger = round(RESIZE * side)
        rgb = F.interpolate(
            images[:, None], (larger, larger), mode="bilinear", antialias=True
        ).expand(-1, 3, -1, -1)
        start = (larger - side) // 2
        inner = slice(start, start + side)
        return (
            F.adaptive_avg_pool2d(self.token_map(rgb[..., inner, inner]), POOL)
            .flatten(2)
            .transpose(1, 2)
        )


@torch.no_grad()
def speed_report(
    tokenizer: Tokenizer,
    published: dict[str, T3Encoder] | None = None,
    rounds: int = 5,
    ours_per_round: int = 10,
) -> dict[str, Any]:
    """Return per encoder its size, ``ms_per_frame`` and ``cpu_ms_per_frame``, and both over ours.

    One 480×640 marker image to latents, resize included, one thread, batch 1, our reference cached. Weights are
    random: speed doesn't depend on what they are. In each round every encoder takes its turn, so that a busy machine
    slows all alike; ours is so much faster that one call is too short to time.
    """
    published = {"T3-medium": T3Encoder()} if published is None else published
    one_thread()
    pairs = equilibrium_pairs(np.random.default_rng(0), 1, "gelsight", "tactip")
    reference, current = pairs.left_reference[:1], pairs.left_current[:1]
    turns = {
        OURS: lambda: len([tokenizer.encode(reference, current) for _ in range(ours_per_round)])
    }
    turns |= {name: _turn(encoder.eval(), current) for name, encoder in published.items()}
    taken = in_turns(turns, rounds, per_frame_ms)
    facts = {OURS: our_size(tokenizer)} | {
        name: size_facts(encoder) for name, encoder in published.items()
    }
    encoders = {name: facts[name] | _timing(taken, name) for name in turns}
    return {
        "what": "one marker image, one CPU thread, medians",
        "repeats": rounds,
        "encoders": encoders,
    }


def our_size(tokenizer: Tokenizer) -> dict[str, Any]:
    """Return ``params`` of our encoder, ``flops_per_frame`` with the reference cached, and of the reference."""
    config = tokenizer.config
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
    """Return ``params`` and ``flops_per_frame``, 2 per multiply-add; the meta device doesn't hide fused attention."""
    side = encoder.config.image_size
    with torch.device("meta"):
        shadow, image = T3Encoder(encoder.config), torch.empty(1, 3, side, side)
    with torch.no_grad(), FlopCounterMode(display=False) as counter:
        shadow.token_map(image)
    return {
        "params": sum(p.numel() for p in encoder.parameters()),
        "flops_per_frame": int(counter.get_total_flops()),
        "input_px": [side, side],
    }


def per_frame_ms(turn: Callable[[], int]) -> tuple[float, float]:
    """Return the time per frame of a turn: by the clock, and of the processor alone, which no other job lengthens."""
    start, cpu_start = time.perf_counter(), time.process_time()
    frames = turn()
    clock, cpu = time.perf_counter() - start, time.process_time() - cpu_start
    return 1000 * clock / frames, 1000 * cpu / frames


def _timing(taken: dict[str, list[tuple[float, float]]], name: str) -> dict[str, float]:
    """Return median times and the medians over rounds of their ratios to ours."""
    (clock, cpu), (our_clock, our_cpu) = (tuple(zip(*taken[n], strict=True)) for n in (name, OURS))
    return {
        "ms_per_frame": median(clock),
        "cpu_ms_per_frame": median(cpu),
        "times_ours": ratio(clock, our_clock),
        "cpu_times_ours": ratio(cpu, our_cpu),
    }


def _turn(encoder: T3Encoder, current: np.ndarray) -> Callable[[], int]:
    images = torch.from_numpy(current)
    bar = (images.shape[-1] - images.shape[-2]) // 2  # to a square, (1, 640, 640)
    return lambda: len(encoder(F.pad(images.float() / 255, (0, 0, bar, bar))))
