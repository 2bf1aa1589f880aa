"""Measure the policy from an observation to a chunk, LeRobot's own loop beside ours."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
from tqdm import tqdm

from benchmarks.policy.latency import CASES, bench_case
from benchmarks.policy.touch import bench_training
from uniforce_cli.boundary import command
from uniforce_vtla.arguments import choose
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import Count, Names, OutFolder, Pattern, Range
from uniforce_vtla.results_file import provenance, write_json

CPU_CASES = "tiny,mid_3_cameras,mid_2_of_3_cameras"
GPU_CASES = "base_3_cameras"
TRAINING_STEPS = 20
BAR_CASE = "mid_2_of_3_cameras"  # whose numbers stand at the top of the file


Case = Annotated[str, Names(tuple(CASES))]
Cases = Annotated[str, Names(tuple(CASES), many=True)]
Device = Annotated[str, Pattern("cpu | cuda", r"cpu|cuda(:\d)?", "cpu")]
FlowSteps = Annotated[int, Range(1, 1000)]


@dataclass
class BenchPolicyConfig:
    """Time a chunk with random weights, stock and fast in turns; write policy_latency.json.

    Example: python -m benchmarks.policy_speed rounds=9
    On a GPU: python -m benchmarks.policy_speed device=cuda rounds=30 training=base_3_cameras
    """

    device: Device = "cpu"  # cpu (one thread) | cuda
    only: Cases = ""  # cases, comma between them; empty = all that fit the device
    # stock and fast once each per round; medians and the median of the ratios are reported
    rounds: Count = 9
    steps: FlowSteps = 10  # flow steps
    # case of which 20 training steps are timed, gradient and tokenizer checked; "" = not
    training: Case = ""
    out: OutFolder = "outputs/bench_policy"  # policy_latency.json


def measure(config: BenchPolicyConfig) -> dict[str, Any]:
    """Return the chosen cases' reports; ContractError: an unknown case, or no CUDA device here."""
    on_gpu = config.device.startswith("cuda")
    if on_gpu and not torch.cuda.is_available():
        raise ContractError(expected("device", "a CUDA device", "none here", "Use device=cpu."))
    fit = GPU_CASES if on_gpu else CPU_CASES
    reports = {}
    for case in tqdm(choose(CASES, config.only or fit).values(), desc="cases"):
        reports[case.name] = bench_case(case, config.device, config.rounds, config.steps)
    head = reports.get(BAR_CASE) or next(iter(reports.values()))
    short = {key: head[key] for key in ("config", "device", "stock_ms", "fast_ms", "ratio")}
    found: dict[str, Any] = {
        "what": "random weights, batch 1, float32 on CPU, bfloat16 on GPU",
        "cpu": None,
        "gpu": "not run",
        "cases": reports,
    }
    found["gpu" if on_gpu else "cpu"] = short
    if config.training:
        case = choose(CASES, config.training)[config.training]
        found["training"] = bench_training(case, config.device, TRAINING_STEPS)
    return found


@command(BenchPolicyConfig)
def main(config: BenchPolicyConfig) -> None:
    torch.set_num_threads(1)
    content = measure(config)
    path = write_json(Path(config.out) / "policy_latency.json", content | provenance())
    for name, r in content["cases"].items():
        print(
            f"{name}: stock {r['stock_ms']:.1f} ms, fast {r['fast_ms']:.1f} ms "
            f"({r['ratio']:.2f}×), floor {r['floor_ms']:.1f} ms; "
            f"operations {r['operations']['fast']} of {r['operations']['stock']}"
        )
    if "training" in content:
        print(f"training: {json.dumps(content['training'])}")
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
