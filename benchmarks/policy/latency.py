"""Latency of one action chunk: LeRobot's own loop and the fast sampler in turns, random weights.

Time depends on shapes alone, so no checkpoint is needed. ``tiny`` is the CPU policy; ``mid`` has
π0.5's depth, cameras, prompt and flow steps at small widths, so that neither launches nor products
of matrices are all of it; ``base`` is the real size, for a GPU.
"""

import copy
import statistics
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.pi05.modeling_pi05 import PI05Pytorch

from benchmarks.policy.counts import count_flops, count_operations
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import (
    PI05UniforceConfig,
    SamplerSettings,
    TinySettings,
    TouchSettings,
)
from lerobot_policy_pi05_uniforce.network import PI05UniforcePytorch
from lerobot_policy_pi05_uniforce.sampler.prefix import Inputs
from uniforce_vtla.keys import ACTION, AXES, STATE

GEMM_SIDE = 1024  # of the square product that anchors the floor


@dataclass(frozen=True)
class BenchCase:
    """One network and one kind of observation."""

    name: str
    size: str = "tiny"
    cameras: int = 3  # slots the policy was built for
    missing: int = 0  # of them not there; LeRobot encodes a constant picture instead
    prompt: int = 50  # real text tokens, of tokenizer_max_length
    settings: dict[str, Any] = field(default_factory=dict)


MID = {
    "tiny": TinySettings(width=256, depth=18, mlp_dim=1024),
    "image_resolution": (224, 224),
    "chunk_size": 50,
    "n_action_steps": 50,
    "max_action_dim": 32,
    "tokenizer_max_length": 200,
}
CASES = {
    case.name: case
    for case in (
        BenchCase("tiny", cameras=2, prompt=30),
        BenchCase("mid_3_cameras", settings=MID),
        BenchCase("mid_2_of_3_cameras", missing=1, settings=MID),
        BenchCase("base_3_cameras", size="base"),
    )
}


def build(case: BenchCase, device: str, touch: TouchSettings | None = None) -> PI05UniforcePytorch:
    """Return a network of random weights, adaptive norms included; without touch by default."""
    torch.manual_seed(0)
    touch = touch or TouchSettings(slots={}, input="none")
    settings = copy.deepcopy(case.settings)
    config = PI05UniforceConfig(size=case.size, device=device, touch=touch, **settings)
    config.input_features = {STATE: PolicyFeature(FeatureType.STATE, (len(AXES),))}
    config.output_features = {ACTION: PolicyFeature(FeatureType.ACTION, (len(AXES),))}
    if case.size == "base":
        config.dtype = "bfloat16"
    with torch.device(device):  # 3 B random numbers take a CPU a minute
        network = PI05UniforcePytorch(config)
    network.state_token = None  # LeRobot's loop knows none
    network.to(device).eval()
    for name, weight in network.named_parameters():
        if "norm.dense.weight" in name:  # starts as zero: every norm would be the same
            torch.nn.init.normal_(weight, std=0.02)
    return network


def observe(
    case: BenchCase, network: PI05UniforcePytorch, device: str
) -> tuple[Inputs, torch.Tensor]:
    """Return cameras, masks, text tokens and their mask for batch 1, and starting noise."""
    config = network.config
    height, width = config.image_resolution
    images = [torch.rand(1, 3, height, width, device=device) * 2 - 1 for _ in range(case.cameras)]
    there = [
        torch.tensor([n < case.cameras - case.missing], device=device) for n in range(case.cameras)
    ]
    tokens = torch.randint(0, 50, (1, config.tokenizer_max_length), device=device)
    mask = torch.arange(config.tokenizer_max_length, device=device)[None] < case.prompt
    noise = torch.randn(1, config.chunk_size, config.max_action_dim, device=device)
    return Inputs(images, there, tokens, mask), noise


def lerobots_layers(network: PI05UniforcePytorch) -> Any:
    """Run LeRobot's own layers in the tiny network; base has no others."""
    return mock.patch.object(network.paligemma_with_expert, "fused", False, create=True)


@contextmanager
def without_graphs(network: PI05UniforcePytorch) -> Any:
    """Let the fast sampler run eagerly, also on a GPU."""
    eager = mock.patch.object(network.config, "sampler", SamplerSettings("eager"))
    with mock.patch.object(network.fast, "graphed", None), eager:
        yield


def samplers(
    network: PI05UniforcePytorch, given: Inputs, noise: torch.Tensor, steps: int
) -> dict[str, Callable]:
    def slow() -> torch.Tensor:
        with lerobots_layers(network):
            *seen, _ = given
            return PI05Pytorch.sample_actions(network, *seen, noise=noise, num_steps=steps)

    return {
        "stock": slow,
        "fast": lambda: network.sample_actions(*given, noise=noise, num_steps=steps),
    }


@torch.no_grad()
def bench_case(case: BenchCase, device: str, rounds: int, steps: int) -> dict[str, Any]:
    """Return latencies [ms], operations, FLOPs, their floor, and how far the results are apart."""
    network = build(case, device)
    given, noise = observe(case, network, device)
    both = samplers(network, given, noise, steps)
    apart = float((both["stock"]() - both["fast"]()).abs().max())  # also warms both up
    times: dict[str, list[float]] = {name: [] for name in both}
    gemm = []
    for _ in range(rounds):
        gemm.append(_gemm_flops_per_s(device))
        for name, sample in both.items():
            times[name].append(milliseconds(sample, device))
    with without_graphs(network):  # a replay asks the dispatcher for nothing
        flops = count_flops(both["fast"])
        operations = {name: count_operations(sample) for name, sample in both.items()}
    report: dict[str, Any] = {
        "config": case.name,
        "device": device_name(device),
        "cameras": case.cameras - case.missing,
        "prompt_tokens": case.prompt,
        "steps": steps,
        "rounds": rounds,
        "max_abs_difference": apart,
        "flops": flops,
        "gemm_flops_per_s": statistics.median(gemm),
        "floor_ms": 1000 * flops / statistics.median(gemm),
        "operations": operations,
        "operations_share": operations["fast"] / operations["stock"],
    }
    for name, values in times.items():
        report[f"{name}_ms"] = statistics.median(values)
        report[f"{name}_p95_ms"] = sorted(values)[min(len(values) - 1, round(0.95 * len(values)))]
    pairs = zip(times["stock"], times["fast"], strict=True)
    report["ratio"] = statistics.median(stock / fast for stock, fast in pairs)
    return report


def milliseconds(call: Callable, device: str) -> float:
    _wait(device)
    start = time.perf_counter()
    call()
    _wait(device)
    return 1000 * (time.perf_counter() - start)


def _wait(device: str) -> None:
    if device.startswith("cuda"):
        torch.cuda.synchronize()


def _gemm_flops_per_s(device: str) -> float:
    dtype = torch.bfloat16 if device.startswith("cuda") else torch.float32
    square = torch.randn(GEMM_SIDE, GEMM_SIDE, device=device, dtype=dtype)
    best = min(milliseconds(lambda: square @ square, device) for _ in range(5))
    return 2 * GEMM_SIDE**3 / best * 1000


def device_name(device: str) -> str:
    return torch.cuda.get_device_name() if device.startswith("cuda") else "CPU, one thread"
