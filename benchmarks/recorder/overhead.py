"""Cost of recording: the robot's read, and the taxels' rate and age."""

import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ledger import Ledger
from benchmarks.recorder.machine import machine_facts
from benchmarks.recorder.plan import Plan, START_s
from benchmarks.recorder.rig import Rig
from benchmarks.recorder.session import TrialError
from uniforce_robots.franka import UniforceFranka, UniforceFrankaConfig
from uniforce_robots.franka.guards import GuardLimits
from uniforce_robots.recorder.ticker import Ticker
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.sensors.uskin_slcan import SlcanUSkin
from uniforce_robots.standins.process import StandIn
from uniforce_vtla.errors import expected

RATE_HZ = 30.0
BOX = GuardLimits(low=(0.1, -0.3, 0.1, -np.pi, 0.0), high=(0.7, 0.3, 0.6, np.pi, 0.08))
FIRST_MS = 30_000  # for the first scan, on a starved machine
ANY_AGE_MS = 1e4


def run(plan: Plan, ledger: Ledger) -> dict[str, Any]:
    plan.folder.mkdir(parents=True, exist_ok=True)
    parts: dict[str, Callable[[Plan], dict[str, Any]]] = {
        "observation_read": _read,
        "uskin": lambda plan: measure_rate(plan.uskin_s),
    }
    for name, part in parts.items():
        if not ledger.read(name):
            ledger.add(name, part(plan) | {"machine": machine_facts()})
    return {name: ledger.read(name)[-1] for name in parts}


def _read(plan: Plan) -> dict[str, Any]:
    folder = plan.folder / "overhead" / "read"
    wait_s = (START_s + plan.overhead_s) * plan.patience
    with Rig(plan, folder) as rig, multiprocessing.get_context("spawn").Pool(1) as pool:
        try:
            return pool.apply_async(measure, (rig.arm.address, plan.overhead_s, folder)).get(wait_s)
        except multiprocessing.TimeoutError as error:
            do = "See what it printed."
            raise TrialError(
                expected("observation_read", f"an end within {wait_s:g} s", "none", do)
            ) from error


def measure(address: str, seconds: float, folder: Path) -> dict[str, float]:
    config = UniforceFrankaConfig(id="trial", calibration_dir=folder, address=address, guards=BOX)
    ticker = Ticker(RATE_HZ)
    took_ms = []
    with UniforceFranka(config) as robot:
        for _ in range(round(seconds * RATE_HZ)):
            ticker.wait()
            begun_s = time.perf_counter()
            seen = robot.get_observation()
            took_ms.append(1e3 * (time.perf_counter() - begun_s))
            robot.send_action(seen)
    found: dict[str, float] = {"reads": len(took_ms)}
    for percent in (50, 95, 99):
        found[f"p{percent}_ms"] = round(float(np.percentile(took_ms, percent)), 3)
    return found


def measure_rate(seconds: float, rate_hz: float = 500.0) -> dict[str, float]:
    """Read a stand-in of its own for some time; every scan it sent is waited for.

    Returns scans sent, received (``samples``), torn (``lost``), not understood (``bad``) and
    received per second at its end; percentiles of the newest scan's age at random times.
    """
    with StandIn("slcan", f"rate_hz={rate_hz}") as stand_in:
        source = SlcanUSkin(stand_in.address)
        source.max_behind_s = 1e9
        reader = SampleReader(source, ReaderLimits(frozen_after=50))
        reader.start()
        try:
            reader.wait_newer(-1, FIRST_MS)
            p50_ms, p99_ms = np.percentile(_ages_ms(reader, seconds), (50, 99)).tolist()
            seen_hz = reader.rate_hz()
            stand_in.inject("stall")
            sent = _until_all_arrived(stand_in, reader)
        finally:
            reader.stop()
    counts = reader.counts
    return {
        "samples": counts.samples,
        "lost": counts.lost,
        "bad": counts.bad,
        "sent": sent,
        "seconds": round(seconds, 3),
        "rate_hz": round(seen_hz, 3),
        "age_p50_ms": round(p50_ms, 3),
        "age_p99_ms": round(p99_ms, 3),
    }


def _ages_ms(reader: SampleReader, seconds: float) -> list[float]:
    rng = np.random.default_rng(0)
    end_s = time.monotonic() + seconds
    ages = []
    while time.monotonic() < end_s:
        time.sleep(rng.uniform(0.002, 0.012))  # at no fixed phase to the scans
        ages.append(reader.newest(ANY_AGE_MS).age_ms)
    return ages


def _until_all_arrived(stand_in: StandIn, reader: SampleReader) -> int:
    """Return the scans that were sent, once the last of them had time to arrive."""
    before = -1
    while reader.counts.samples != before:
        before = reader.counts.samples
        time.sleep(0.3)
    return stand_in.stats()["sent"]
