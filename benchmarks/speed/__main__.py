"""Measure latencies and throughputs, each beside an anchor measured in the same run."""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from uniforce_cli.boundary import command, one_thread
from uniforce_vtla.options import Names, OutFolder, Positive
from uniforce_vtla.results_file import provenance, write_json

Stage = Annotated[str, Names(("canonicalize", "contact", "encode", "env"))]


@dataclass
class BenchConfig:
    """Measure every stage on one core and write ``bench.json``.

    Example: python -m benchmarks.speed seconds=2 only=contact
    """

    # per measurement; timings on shared machines are noisy, longer is steadier
    seconds: Positive = 2.0
    only: Stage = ""  # canonicalize | contact | encode | env; empty = all
    out: OutFolder = "outputs/bench"  # bench.json goes here


def _benches() -> dict[str, Callable[[float], dict[str, Any]]]:
    from benchmarks.speed.canonicalizer import bench_canonicalizer
    from benchmarks.speed.contact import bench_contact
    from benchmarks.speed.encode import bench_encode
    from benchmarks.speed.env import bench_env

    return {
        "canonicalize": bench_canonicalizer,
        "contact": bench_contact,
        "encode": bench_encode,
        "env": bench_env,
    }


def run(config: BenchConfig) -> dict[str, Any]:
    """Run the chosen benches one after another; anchors of all of them end up under ``anchors``."""
    one_thread()
    results: dict[str, Any] = {"anchors": {}}
    for name, bench in _benches().items():
        if config.only in ("", name):
            measured = bench(config.seconds)
            results["anchors"] |= measured.pop("anchors", {})
            results |= measured
    return results


@command(BenchConfig)
def main(config: BenchConfig) -> None:
    results = run(config)
    path = write_json(
        Path(config.out) / "bench.json", results | {"config": asdict(config)} | provenance()
    )
    for name, value in results.items():
        print(f"{name}: {value}")
    print(f"written to {path}")


if __name__ == "__main__":
    sys.exit(main())
