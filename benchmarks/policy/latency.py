"""Time from an observation to a chunk, by parts, beside LeRobot's loop and the machine's floor."""

import statistics
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import FlopCounterMode

from benchmarks.policy.network import (
    CAMERAS,
    PROMPT,
    Device,
    Size,
    build,
    check_device,
    in_turns,
    milliseconds,
    observe,
    ratio,
    sampler_of,
    samplers,
)
from lerobot_policy_pi05_uniforce import PI05UniforcePolicy
from lerobot_policy_pi05_uniforce import make_pi05_uniforce_pre_post_processors as make_processors
from lerobot_policy_pi05_uniforce.touch.touch_input import PAIR_KEYS
from uniforce_cli.boundary import command
from uniforce_vtla.contracts import MARKER_IMAGE_SHAPE
from uniforce_vtla.keys import ACTION, AXES, STATE
from uniforce_vtla.options import Count, OutFolder
from uniforce_vtla.results_file import provenance, write_json

# operations that move no data
VIEWS = {"alias", "as_strided", "detach", "expand", "permute", "select", "slice", "split", "t"}
VIEWS |= {"split_with_sizes", "squeeze", "transpose", "unbind", "unsqueeze", "view", "_unsafe_view"}
# side of a square product and bytes of a copy, large enough to reach the machine's ceilings
ANCHORS = {"cuda": (8192, 2**31), "cpu": (1024, 2**26)}


@dataclass
class LatencyConfig:
    """Time a chunk of random weights, LeRobot's loops and ours in turns; write latency.json.

    Example: python -m benchmarks.policy.latency
    On a GPU: python -m benchmarks.policy.latency device=cuda size=base rounds=30
    """

    device: Device = "cpu"  # cpu (one thread) | cuda
    size: Size = "tiny"  # base is in bfloat16
    rounds: Count = 9  # each call once per round
    steps: Count = 10  # flow steps
    out: OutFolder = "outputs/bench_policy"  # latency.json


class _Operations(TorchDispatchMode):
    """Counts what the dispatcher is asked for, views aside: a launch each on a GPU."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += func._schema.name.split("::")[1] not in VIEWS
        return func(*args, **(kwargs or {}))


def count_operations(call: Callable) -> int:
    with _Operations() as counter:
        call()
    return counter.count


@torch.no_grad()
def measure(config: LatencyConfig) -> dict[str, Any]:
    """Return all figures; ContractError: no CUDA device here."""
    check_device(config.device)
    policy = build(config.size, config.device, "bfloat16")
    policy.config.num_inference_steps = config.steps
    warm_up_s = milliseconds(policy.warm_up, config.device) / 1000
    network = policy.model
    given, noise = observe(policy)
    sampler = sampler_of(network)
    sampler.compiles = True  # on a GPU, these shapes too: they hold no touch
    calls = samplers(network, given, noise, config.steps)
    times = in_turns(calls, config.device, config.rounds)
    stock = calls["stock"]()
    apart = float((stock - calls["fast"]()).abs().max())
    eager = mock.patch.object(policy.config.sampler, "kind", "eager")
    # a replay asks the dispatcher for nothing
    with eager, mock.patch.object(sampler, "recordings", None):
        operations = {name: count_operations(call) for name, call in calls.items()}
        with FlopCounterMode(display=False) as counter:
            calls["fast"]()
    found: dict[str, Any] = {
        "config": vars(config) | {"cameras": len(CAMERAS), "prompt_tokens": PROMPT},
        "warm_up_s": warm_up_s,
        "ms": {name: statistics.median(values) for name, values in times.items()},
        "ratio": {name: ratio(times[name], times["fast"]) for name in times if name != "fast"},
        "max_abs_difference": apart,
        "largest_action": float(stock.abs().max()),
        "operations": operations,
        "floor": floor(policy, config, counter.get_total_flops()),
    }
    found["floor"]["times_floor"] = found["ms"]["fast"] / found["floor"]["ms"]
    found["end_to_end_ms"] = end_to_end(policy, config)
    return found


def floor(policy: PI05UniforcePolicy, config: LatencyConfig, flops: int) -> dict[str, float]:
    """Return the least time of a call: its operations or its weights, at measured ceilings."""
    side, size = ANCHORS[config.device.partition(":")[0]]
    prepared = sampler_of(policy.model).prepared
    square = torch.randn(side, side, device=config.device, dtype=prepared.dtype)
    source = torch.empty(size, dtype=torch.uint8, device=config.device)
    target = torch.empty_like(source)
    calls = {"product": lambda: square @ square, "copy": lambda: target.copy_(source)}
    best_ms = {name: min(ms) for name, ms in in_turns(calls, config.device, 10).items()}
    flops_per_s = 2000 * side**3 / best_ms["product"]
    bytes_per_s = 2000 * size / best_ms["copy"]  # read and written
    read = 0
    modules = [prepared.tower, prepared.projector, policy.model.vlm.layers]
    for module in [*modules, *[policy.model.expert.layers] * config.steps]:
        read += sum(p.numel() * p.element_size() for p in module.parameters())
    least_ms = 1000 * max(flops / flops_per_s, read / bytes_per_s)
    return {
        "flops": flops,
        "weight_bytes": read,
        "product_flops_per_s": flops_per_s,
        "copy_bytes_per_s": bytes_per_s,
        "ms": least_ms,
    }


def end_to_end(policy: PI05UniforcePolicy, config: LatencyConfig) -> dict[str, float]:
    """Return medians [ms] of ``select_action`` from bytes on the host to an action there."""
    one = torch.ones(len(AXES))
    stats = {key: {"q01": -one, "q99": one, "min": -one, "max": one} for key in (STATE, ACTION)}
    before, after = make_processors(policy.config, stats)
    raw: dict[str, Any] = {"task": ["wipe the ink off the board"], STATE: torch.zeros(len(AXES))}
    for key, feature in policy.config.image_features.items():
        raw[key] = torch.randint(0, 255, feature.shape, dtype=torch.uint8)
    markers = torch.zeros(1, *MARKER_IMAGE_SHAPE, dtype=torch.uint8)
    markers[..., ::16, :] = 255
    for keys in PAIR_KEYS.values():
        raw |= dict.fromkeys(keys, markers)
    batch = before(dict(raw))
    chunk = policy.predict_action_chunk(batch)

    def whole(touched: bool) -> torch.Tensor:
        policy._action_queue.clear()
        slots = policy.config.touch.slots if touched else {}
        with mock.patch.object(policy.config.touch, "slots", slots):
            return after(policy.select_action(before(dict(raw))))

    calls = {
        "whole": lambda: whole(True),
        "whole_without_touch": lambda: whole(False),
        "preprocessor": lambda: before(dict(raw)),
        "cameras": lambda: policy._preprocess_images(batch),
        "touch_to_latents": lambda: policy.felt(batch),
        "prefix_and_flow_with_the_three_above": lambda: policy.predict_action_chunk(batch),
        "postprocessor": lambda: after(chunk[:, 0]),
    }
    times = in_turns(calls, config.device, config.rounds)
    found = {name: statistics.median(values) for name, values in times.items()}
    pairs = zip(times["whole"], times["whole_without_touch"], strict=True)
    return found | {"touch": statistics.median(a - b for a, b in pairs)}


@command(LatencyConfig)
def main(config: LatencyConfig) -> None:
    found = measure(config)
    path = write_json(Path(config.out) / "latency.json", found | provenance())
    for name, ms in (found["ms"] | found["end_to_end_ms"]).items():
        print(f"{name:40} {ms:9.2f} ms")
    ratios = {name: round(times, 2) for name, times in found["ratio"].items()}
    print(f"warm-up {found['warm_up_s']:.1f} s; over ours: {ratios}")
    print(f"floor {found['floor']['ms']:.2f} ms, ours {found['floor']['times_floor']:.1f} of it")
    print(f"differs by {found['max_abs_difference']:.1e} of {found['largest_action']:.1f}; {path}")


if __name__ == "__main__":
    sys.exit(main())
