"""What reading a device costs and how old its newest sample is, in this tree and in another, turn and turn about.

Example: git worktree add /tmp/former cd971e6; python -m benchmarks.device_libraries former=/tmp/former/

Each measurement is a process that reads a stand-in of this tree with one tree's driver.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_robots.standins.process import StandIn
from uniforce_vtla.arguments import parse
from uniforce_vtla.results_file import provenance, write_json

ROOT = Path(__file__).parents[1]
PACKAGES = ("", "devices", "robots", "teleoperators", "standins")
STAND_INS = {
    "xela": ("xela", "rate_hz=500"),
    "slcan": ("slcan", "rate_hz=500"),
    "mjpeg": ("mjpeg", "sensor=tactip", "rate_hz=30"),
    "gello": ("gello",),
}
READER = """
import json, random, sys, time
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
kind, address, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
random.seed(0)
if kind == "xela":
    from uniforce_robots.sensors.uskin_server import ServerUSkin
    source = ServerUSkin(address)
elif kind == "slcan":
    from uniforce_robots.sensors.uskin_slcan import SlcanUSkin
    source = SlcanUSkin(address)
elif kind == "gello":
    from uniforce_robots.teleop.gello_bus import GelloBus
    source = GelloBus(address, tuple(range(1, 9)), 57_600)
else:
    from uniforce_robots.sensors import UniforceSceneCamera, UniforceSceneCameraConfig
    source = UniforceSceneCamera(UniforceSceneCameraConfig(source=address))._source
spent, plain = [0.0], source.read
def read():
    began = time.thread_time()
    try:
        return plain()
    finally:
        spent[0] += time.thread_time() - began
source.read = read
reader = SampleReader(source, ReaderLimits(frozen_after=0))
reader.start()
reader.wait_newer(-1, 60_000)
before, cost, ages, end = reader.counts, spent[0], [], time.monotonic() + seconds
while time.monotonic() < end:
    time.sleep(random.uniform(0.002, 0.012))
    ages.append(reader.newest(1e5).age_ms())
after, cost = reader.counts, spent[0] - cost
reader.stop()
samples = after.samples - before.samples
print(json.dumps({"samples": samples, "lost": after.lost - before.lost, "bad": after.bad - before.bad,
    "cost_us": 1e6 * cost / max(samples, 1), "ages_ms": ages}))
"""

PYTHON_CAN = """
import can, json, sys, time
seconds = float(sys.argv[3])
bus = can.Bus(interface="slcan", channel=sys.argv[2], tty_baudrate=3_000_000, bitrate=1_000_000, sleep_after_open=0)
frames, bad, began, end = 0, 0, time.thread_time(), time.monotonic() + seconds
while time.monotonic() < end:
    try:
        frames += bus.recv(0.05) is not None
    except (can.CanError, ValueError):  # half a line, after an earlier reader left
        bad += 1
cost = time.thread_time() - began
bus.shutdown()
print(json.dumps({"samples": frames // 16, "lost": 0, "bad": bad, "cost_us": 1e6 * cost / max(frames / 16, 1),
    "ages_ms": []}))
"""


@dataclass
class LibrariesConfig:
    """Measure device drivers, this tree's and a former one's.

    Example: python -m benchmarks.device_libraries former=/tmp/former out=docs/results/device_libraries.json
    """

    former: str = (
        ""  # root of another checkout; empty measures this one alone (with python-can where it is installed)
    )
    kinds: str = "xela,slcan,mjpeg,gello"  # which devices
    seconds: float = 5.0  # of one measurement
    times: int = 4  # measurements of each
    out: str = "docs/results/device_libraries.json"


def measure(tree: Path, kind: str, address: str, seconds: float, reader: str = READER) -> dict[str, Any]:
    """Return one measurement: samples, lost, bad, CPU time per sample in its read, ages of the newest sample."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(str(tree / name) for name in PACKAGES)}
    command = [sys.executable, "-c", reader, kind, address, str(seconds)]
    done = subprocess.run(
        command, env=environment, cwd=tree, stdout=subprocess.PIPE, text=True, check=True, timeout=200
    )
    return json.loads(done.stdout.splitlines()[-1])


def summary(runs: list[dict[str, Any]], seconds: float) -> dict[str, float]:
    """Return medians over the measurements of one driver."""
    ages = np.concatenate([run["ages_ms"] for run in runs])
    numbers = {
        "rate_hz": np.median([run["samples"] for run in runs]) / seconds,
        "lost": sum(run["lost"] for run in runs),
        "bad": sum(run["bad"] for run in runs),
        "read_cpu_us_per_sample": np.median([run["cost_us"] for run in runs]),
    }
    if len(ages):
        numbers |= {"age_p50_ms": np.percentile(ages, 50), "age_p95_ms": np.percentile(ages, 95)}
    return {name: round(float(value), 2) for name, value in numbers.items()}


def main() -> int:
    """Measure, print and store."""
    config = parse(LibrariesConfig)
    trees = {"this": ROOT} | ({"former": Path(config.former)} if config.former else {})
    found = {}
    for kind in config.kinds.split(","):
        with StandIn(*STAND_INS[kind], "fault=none") as stand_in:
            runs: dict[str, list] = {name: [] for name in trees}
            for _ in range(config.times):
                for name, tree in trees.items():
                    runs[name].append(measure(tree, kind, stand_in.address, config.seconds))
                if kind == "slcan" and importlib.util.find_spec("can"):
                    run = measure(ROOT, kind, stand_in.address, config.seconds, PYTHON_CAN)
                    runs.setdefault("python-can", []).append(run)
        found[kind] = {name: summary(many, config.seconds) for name, many in runs.items()}
        print(kind, json.dumps(found[kind], indent=1))
    write_json(
        Path(config.out),
        {"devices": found, "seconds": config.seconds, "times": config.times, "seed": 0} | provenance(),
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
