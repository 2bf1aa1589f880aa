"""Cost of touch: two slots of 16 cached latents at either token site beside none, latency and training step.

All variants are timed in turns in one process, so that a busy machine slows them alike; ratios are medians of ratios
within a round. Random weights; the gate of ``start_at_base`` is on, as for size ``base``, and training steps run
LeRobot's own layers, as ``base`` does. (Through torch's fused attention, which ``tiny`` trains by, a gate that learns
costs a third of a step on a CPU: a mask with a gradient sends torch to its slow path. ``tiny`` has no gate.)

Training steps on one random sample ask besides: does the gradient reach touch, does the tokenizer stay? ``tiny`` and
``mid`` are the code of ``base`` at reduced width, for a CPU; ``base_3_cameras`` is the real size, for a GPU.
"""

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import torch

from benchmarks.policy.latency import (
    BenchCase,
    build,
    device_name,
    lerobots_layers,
    milliseconds,
    observe,
)
from benchmarks.timing import in_turns, ratio
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs, drop_padding
from lerobot_policy_pi05_uniforce.touch.tokens import Felt
from uniforce_vtla.tokenizer.weights import content_hash

SLOTS = {"touch0": "right", "touch1": "left"}
Call = Callable[[], Any]
TOUCH_MODULES = ("force_tokens", "touch_gate")
LEARNING_RATE = 2.5e-5  # peak of base


def variants() -> dict[str, TouchSettings]:
    return {
        "none": TouchSettings(slots={}, input="none"),
        "prefix": TouchSettings(slots=SLOTS, input="latent", site="prefix", start_at_base=True),
        "suffix": TouchSettings(slots=SLOTS, input="latent", site="suffix", start_at_base=True),
    }


def bench_touch(case: BenchCase, device: str, rounds: int, steps: int) -> dict[str, Any]:
    """Return medians [ms] and ratios to "none" of a whole call and a training step."""
    calls: dict[str, Call] = {}
    trains: dict[str, Call] = {}
    for name, settings in variants().items():
        network = build(case, device, settings)
        given, noise = with_touch(network, *observe(case, network, device))
        calls[name] = partial(network.sample_actions, *given, noise=noise, num_steps=steps)
        trains[name] = _training(network, given, noise, 0.0)
    report: dict[str, Any] = {"config": case.name, "tokens": len(SLOTS) * 16, "rounds": rounds}
    with torch.no_grad():
        report |= _in_turns(calls, device, rounds, "call")
    return report | _in_turns(trains, device, max(3, rounds // 3), "train_step")


def with_touch(
    network: PI05UniforcePytorch, given: Inputs, noise: torch.Tensor
) -> tuple[Inputs, torch.Tensor]:
    """Add cached latents of every slot and leave text padding out, as the trainer does for short prompts."""
    config = network.config
    felt = Felt()
    if config.slots:
        touches = torch.randn(len(config.slots), 1, *config.touch_shape, device=noise.device)
        felt = Felt(None, touches, torch.ones(touches.shape[:2], dtype=torch.bool).to(noise.device))
    tokens, masks = drop_padding(given.tokens, given.masks)
    return Inputs(given.images, given.img_masks, tokens, masks, felt), noise


def _training(
    network: PI05UniforcePytorch,
    given: Inputs,
    noise: torch.Tensor,
    learning_rate: float,
    look: Callable[[torch.Tensor], None] = lambda loss: None,
) -> Call:
    """Return a training step on one sample; ``look`` is given its loss while the gradients are there."""
    optimizer = torch.optim.AdamW(
        [p for p in network.parameters() if p.requires_grad], lr=learning_rate
    )
    actions, time = torch.zeros_like(noise), noise.new_full((1,), 0.5)

    def step() -> None:
        with lerobots_layers(network):
            loss = network.forward(*given, actions=actions, noise=noise, time=time).mean()
            loss.backward()
        look(loss)
        optimizer.step()
        optimizer.zero_grad()

    return step


def _in_turns(calls: dict[str, Call], device: str, rounds: int, what: str) -> dict[str, Any]:
    times = in_turns(calls, rounds, lambda call: milliseconds(call, device))
    medians = {name: statistics.median(values) for name, values in times.items()}
    return {
        f"{what}_ms": medians,
        f"{what}_ratio_to_none": {
            name: ratio(values, times["none"]) for name, values in times.items()
        },
    }


def bench_training(
    case: BenchCase, device: str, steps: int, learning_rate: float = LEARNING_RATE
) -> dict[str, Any]:
    """Return losses, gradient norms of touch at every step, the tokenizer's hash before and after, and times [ms]."""
    network = build(case, device, variants()["prefix"]).train()
    given, noise = with_touch(network, *observe(case, network, device))
    losses: list[float] = []
    norms: dict[str, list[float]] = {name: [] for name in TOUCH_MODULES}

    def look(loss: torch.Tensor) -> None:
        losses.append(float(loss.detach()))
        for name, rows in norms.items():
            grads = [
                p.grad.float() for p in getattr(network, name).parameters() if p.grad is not None
            ]
            rows.append(float(torch.nn.utils.get_total_norm(grads)))

    before = tokenizer_hash(network)
    step = _training(network, given, noise, learning_rate, look)
    times = [milliseconds(step, device) for _ in range(steps)]
    return {
        "config": case.name,
        "device": device_name(device),
        "steps": steps,
        "batch": 1,
        "weights_B": sum(p.numel() for p in network.parameters()) / 1e9,
        "step_ms": statistics.median(times),
        "first_step_ms": times[0],
        "losses": losses,
        "gradient_norms": norms,
        "tokenizer_unchanged": tokenizer_hash(network) == before,
        "peak_GiB": torch.cuda.max_memory_allocated() / 2**30
        if device.startswith("cuda")
        else None,
    }


def tokenizer_hash(network: PI05UniforcePytorch) -> str:
    """Return the content hash of the frozen tokenizer inside the network."""
    assert network.tactile_encoder is not None, "the bench builds it with latents"
    facts = {
        name: fact
        for name, fact in (network.config.touch.tokenizer or {}).items()
        if name != "hash"
    }
    return content_hash(network.tactile_encoder.model, facts)
