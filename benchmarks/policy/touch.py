"""Training steps with touch: does the gradient reach it, does the tokenizer stay?

Random weights on one random sample; the gate of ``start_at_base`` is on, and steps run LeRobot's
own layers, as ``base`` does. ``tiny`` and ``mid`` are the code of ``base`` at reduced width, for a
CPU; ``base_3_cameras`` is the real size, for a GPU.
"""

import statistics
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
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TouchSettings
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs, drop_padding
from lerobot_policy_pi05_uniforce.touch.tokens import Felt
from uniforce_vtla.tokenizer.weights import content_hash

SLOTS = {"touch0": "right", "touch1": "left"}
TOUCH_MODULES = ("force_tokens", "touch_gate")
LEARNING_RATE = 2.5e-5  # peak of base


def bench_training(
    case: BenchCase, device: str, steps: int, learning_rate: float = LEARNING_RATE
) -> dict[str, Any]:
    """Return losses, gradient norms of touch, the tokenizer's hash kept or not, and times [ms]."""
    touch = TouchSettings(slots=SLOTS, input="latent", start_at_base=True)
    network = build(case, device, touch).train()
    given, noise = observe(case, network, device)
    given = with_touch(network, given, noise)
    actions = torch.zeros_like(noise)
    time = noise.new_full((1,), 0.5)
    learnt = [p for p in network.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(learnt, lr=learning_rate)
    losses: list[float] = []
    norms: dict[str, list[float]] = {name: [] for name in TOUCH_MODULES}

    def step() -> None:
        with lerobots_layers(network):
            loss = network.forward(*given, actions=actions, noise=noise, time=time).mean()
            loss.backward()
        losses.append(float(loss.detach()))
        for name, rows in norms.items():
            parameters = getattr(network, name).parameters()
            grads = [p.grad.float() for p in parameters if p.grad is not None]
            rows.append(float(torch.nn.utils.get_total_norm(grads)))
        optimizer.step()
        optimizer.zero_grad()

    before = tokenizer_hash(network)
    times = [milliseconds(step, device) for _ in range(steps)]
    peak_GiB = None
    if device.startswith("cuda"):
        peak_GiB = torch.cuda.max_memory_allocated() / 2**30
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
        "peak_GiB": peak_GiB,
    }


def with_touch(network: PI05UniforcePytorch, given: Inputs, noise: torch.Tensor) -> Inputs:
    """Add cached latents of every slot and leave text padding out, as for short prompts."""
    config = network.config
    touches = torch.randn(len(config.slots), 1, *config.touch_shape, device=noise.device)
    real = torch.ones(touches.shape[:2], dtype=torch.bool, device=noise.device)
    tokens, masks = drop_padding(given.tokens, given.masks)
    felt = Felt(None, touches, real)
    return Inputs(given.images, given.img_masks, tokens, masks, felt)


def tokenizer_hash(network: PI05UniforcePytorch) -> str:
    """Return the content hash of the frozen tokenizer inside the network."""
    assert network.tactile_encoder is not None, "the bench builds it with latents"
    facts = dict(network.config.touch.tokenizer or {})
    facts.pop("hash", None)
    return content_hash(network.tactile_encoder.model, facts)
