"""Chart of time against accuracy over flow steps, on one device: bfloat16 and float32."""

import statistics
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks.policy.network import (
    Device,
    Size,
    build,
    check_device,
    in_turns,
    observe,
    sampler_of,
    samplers,
)
from uniforce_cli.boundary import command
from uniforce_vtla.errors import ContractError
from uniforce_vtla.json_file import read_object
from uniforce_vtla.options import Count, FilePath, OutFolder
from uniforce_vtla.results_file import provenance, write_json

STEPS = (1, 2, 3, 5, 10, 20)
EXACT_STEPS = 50
# of others' own pages and machines, ms a chunk of ten steps; never a point of ours
PUBLISHED = {"SGLang, H200": 43.1, "openpi JAX, H100": 53.0}


@dataclass
class ChartConfig:
    """Time chunks of several flow steps, and how far they are from 50 in float32; write chart.json.

    Example: python -m benchmarks.policy.chart device=cuda size=base
    then, anywhere: python -m benchmarks.policy.chart drawn=outputs/bench_policy/chart.json
    """

    device: Device = "cpu"  # cpu (one thread) | cuda
    size: Size = "tiny"
    rounds: Count = 9  # chunks per point
    # a chart.json to draw beside itself; nothing is measured then
    drawn: FilePath = ""
    out: OutFolder = "outputs/bench_policy"  # chart.json


@torch.no_grad()
def measure(config: ChartConfig) -> dict[str, Any]:
    """Return a row per dtype and number of steps; ContractError: no CUDA device here."""
    check_device(config.device)
    policy = build(config.size, config.device)
    given, noise = observe(policy)
    sampler_of(policy.model).compiles = True  # on a GPU

    def sample(steps: int) -> torch.Tensor:
        return samplers(policy.model, given, noise, steps)["fast"]()

    exact = sample(EXACT_STEPS)
    points = []
    for dtype in ("float32", "bfloat16"):
        policy.model.paligemma_with_expert.to_bfloat16_for_selected_params(dtype)
        for steps in STEPS:
            apart = (sample(steps) - exact).abs()
            times = in_turns({"": partial(sample, steps)}, config.device, config.rounds)
            ms = statistics.median(times[""])
            row = {"dtype": dtype, "steps": steps, "ms": ms, "max": float(apart.max())}
            points.append(row | {"rms": float(apart.square().mean().sqrt())})
    largest = float(exact.abs().max())
    return {"size": config.size, "largest_action": largest, "points": points}


def draw(content: dict[str, Any], path: Path) -> None:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4))
    for dtype in ("float32", "bfloat16"):
        rows = [point for point in content["points"] if point["dtype"] == dtype]
        axes.loglog([r["ms"] for r in rows], [r["rms"] for r in rows], "o-", label=dtype)
        for row in rows:
            axes.annotate(str(row["steps"]), (row["ms"], row["rms"]))
    if content["size"] == "base":
        for name, ms in PUBLISHED.items():
            axes.axvline(ms, linestyle=":", color="grey")
            axes.annotate(f"{name} (published)", (ms, axes.get_ylim()[0]), rotation=90)
    axes.set(xlabel=f"ms a chunk, {content['device']}", ylabel="rms distance to 50 float32 steps")
    axes.legend()
    figure.savefig(path, bbox_inches="tight")


@command(ChartConfig)
def main(config: ChartConfig) -> None:
    if config.drawn:
        path = Path(config.drawn).with_suffix(".png")
        draw(read_object(Path(config.drawn), ContractError), path)
    else:
        content = measure(config)
        path = write_json(Path(config.out) / "chart.json", content | provenance())
        for row in content["points"]:
            print("{dtype} {steps:3} steps {ms:8.2f} ms, rms {rms:.1e}".format(**row))
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
