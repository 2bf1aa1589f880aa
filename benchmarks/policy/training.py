"""Training steps of π0.5 with touch on one random sample: does the gradient reach touch, does the tokenizer stay?

The path of ``base``: LeRobot's own layers, flow matching, the gate of ``start_at_base``. ``tiny`` and ``mid`` are its
code at reduced width, for a CPU; ``base_3_cameras`` is the real size, for a GPU.
"""

import statistics
from typing import Any

import torch

from benchmarks.policy.latency import BenchCase, build, device_name, lerobots_layers, milliseconds, observe
from benchmarks.policy.touch import variants, with_touch
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from uniforce_vtla.tokenizer.weights import content_hash

TOUCH_MODULES = ("force_tokens", "touch_gate")
LEARNING_RATE = 2.5e-5  # peak of base


def bench_training(case: BenchCase, device: str, steps: int, learning_rate: float = LEARNING_RATE) -> dict[str, Any]:
    """Return losses, gradient norms of touch at every step, the tokenizer's hash before and after, and times [ms]."""
    network = build(case, device, variants()["prefix"]).train()
    given, noise = with_touch(network, *observe(case, network, device))
    optimizer = torch.optim.AdamW([p for p in network.parameters() if p.requires_grad], lr=learning_rate)
    actions, time = torch.zeros_like(noise), noise.new_full((1,), 0.5)
    losses: list[float] = []
    norms: dict[str, list[float]] = {name: [] for name in TOUCH_MODULES}

    def step() -> None:
        with lerobots_layers(network):
            loss = network.forward(*given, actions, noise, time).mean()
            loss.backward()
        for name, rows in norms.items():
            rows.append(gradient_norm(getattr(network, name)))
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss.detach()))

    before = tokenizer_hash(network)
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
        "peak_GiB": torch.cuda.max_memory_allocated() / 2**30 if device.startswith("cuda") else None,
    }


def gradient_norm(module: torch.nn.Module) -> float:
    """Return the norm of a module's gradient; 0 without one."""
    grads = [p.grad.float().square().sum() for p in module.parameters() if p.grad is not None]
    return float(torch.stack(grads).sum().sqrt()) if grads else 0.0


def tokenizer_hash(network: PI05UniforcePytorch) -> str:
    """Return the content hash of the frozen tokenizer inside the network."""
    assert network.tactile_encoder is not None, "the bench builds it with latents"
    facts = {name: fact for name, fact in (network.config.touch.tokenizer or {}).items() if name != "hash"}
    return content_hash(network.tactile_encoder.model, facts)
