"""What recording costs: the robot's read, the recorder's processes in cores, and the taxels' rate and age."""

import multiprocessing
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.ledger import Ledger
from benchmarks.recorder.cpu import CpuMeter, machine_facts
from benchmarks.recorder.end_to_end import BEGUN, lateness_ms, observe_p95_ms
from benchmarks.recorder.observation_read import measure
from benchmarks.recorder.plan import Plan, START_s
from benchmarks.recorder.rig import Rig
from benchmarks.recorder.session import TrialError
from benchmarks.recorder.uskin_rate import measure_rate
from uniforce_datasets.source import read_source
from uniforce_vtla.errors import expected
from uniforce_vtla.keys import STAMPS

SETTLE_s = 2.0  # into the episode, before it is measured
COUNTED = "the loop with its threads and the storing process with its encoders; stand-ins and harness are not"


def run(plan: Plan, ledger: Ledger) -> dict[str, Any]:
    """Measure what is missing; return the newest of each."""
    plan.folder.mkdir(parents=True, exist_ok=True)
    parts: dict[str, Callable[[Plan], dict[str, Any]]] = {
        "observation_read": _read,
        "recorder": _recorder,
        "recorder_without_raw": partial(_recorder, keep_raw=False),
        "uskin": lambda plan: measure_rate(plan.uskin_s),
    }
    for name, part in parts.items():
        if not ledger.read(name):
            ledger.add(name, part(plan) | {"machine": machine_facts()})
    return {name: ledger.read(name)[-1] for name in parts}


def _read(plan: Plan) -> dict[str, Any]:
    folder, wait_s = plan.folder / "overhead" / "read", (START_s + plan.overhead_s) * plan.patience
    with Rig(plan, folder) as rig, multiprocessing.get_context("spawn").Pool(1) as pool:
        try:
            return pool.apply_async(measure, (rig.arm.address, plan.overhead_s, folder)).get(wait_s)
        except multiprocessing.TimeoutError as error:
            do = "See what it printed."
            raise TrialError(expected("observation_read", f"an end within {wait_s:g} s", "none", do)) from error


def _recorder(plan: Plan, keep_raw: bool = True) -> dict[str, Any]:
    folder = plan.folder / "overhead" / ("recorder" if keep_raw else "recorder_without_raw")
    root = folder / f"data{len(list(folder.glob('data*')))}"
    with Rig(plan, folder) as rig:
        length_s = plan.overhead_s + 2 * SETTLE_s
        with rig.session(root, episodes=1, episode_s=length_s, keep_raw=keep_raw) as session:
            session.wait_for(BEGUN, START_s)
            time.sleep(SETTLE_s)
            loop, *children = session.processes()
            meter = CpuMeter({"recording_loop": [loop], "storing_process": children})
            time.sleep(plan.overhead_s)
            cores = meter.read()
            code = session.wait_end(START_s + plan.overhead_s)
    whole = cores["recording_loop"] + cores["storing_process"]
    return {"cores": round(whole, 3), "cores_by_process": cores, "counted": COUNTED, "exit_code": code} | _beat(root)


def _beat(root: Any) -> dict[str, Any]:
    source = read_source(root)
    stamps_s = source.columns((STAMPS,))[STAMPS]
    late_ms, missed = lateness_ms(stamps_s[:, 0], source.fps)
    return {
        "frames": source.num_frames,
        "observation_with_images_p95_ms": round(observe_p95_ms(stamps_s), 2),
        "tick_jitter_p99_ms": round(float(np.percentile(late_ms, 99)), 3),
        "ticks_missed": missed,
    }
