"""Limits of this machine: the beat of a loop that does nothing, and who used the cores."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterable
from multiprocessing.connection import Connection

import numpy as np
import psutil

from uniforce_robots.recorder.ticker import Ticker

END_s = 60.0


def tick(rate_hz: float, pipe: Connection) -> None:
    """Tick until something comes through the pipe; send each beat's time, s, and delay, ms."""
    ticker = Ticker(rate_hz)
    time_s = []
    late_ms = []
    while not pipe.poll():
        late_ms.append(round(1e3 * ticker.wait(), 4))
        time_s.append(round(time.monotonic(), 4))
    pipe.send((time_s, late_ms))


class IdleLoop:
    """An idle loop on the recorder's own ticker, in a process of its own."""

    def __init__(self, rate_hz: float) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._pipe, theirs = spawn.Pipe()
        self._process = spawn.Process(target=tick, args=(rate_hz, theirs), daemon=True)
        self._process.start()
        theirs.close()

    @property
    def pid(self) -> int:
        return int(self._process.pid or 0)

    def __enter__(self) -> IdleLoop:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()

    def stop(self) -> tuple[np.ndarray, np.ndarray]:
        """End it; return when each beat came, ``time.monotonic`` s, and how late it was, ms.

        Raises TimeoutError: no answer.
        """
        self._pipe.send("end")
        if not self._pipe.poll(END_s):
            raise TimeoutError(f"the idle loop did not end within {END_s:g} s")
        time_s, late_ms = self._pipe.recv()
        return np.array(time_s), np.array(late_ms)


def cpu_s(processes: Iterable[psutil.Process]) -> float:
    """Return the CPU seconds processes and the children they have outlived used so far."""
    total_s = 0.0
    for process in processes:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total_s += times.user + times.system + times.children_user + times.children_system
    return total_s


class CpuMeter:
    """Cores used by each group of processes from now until ``read``; they must be the same then."""

    def __init__(self, groups: dict[str, list[psutil.Process]]) -> None:
        self._groups = groups
        self._begun = self._now()

    def read(self) -> dict[str, float]:
        """Return cores by group and ``everything_else`` on this machine; 1.0 is one whole core."""
        ended = self._now()
        used_s = {name: ended[name] - begun for name, begun in self._begun.items()}
        wall_s = used_s.pop("wall")
        others = used_s.pop("machine") - sum(used_s.values())
        cores = {name: round(spent / wall_s, 3) for name, spent in used_s.items()}
        return cores | {"everything_else": round(max(others / wall_s, 0.0), 3)}

    def _now(self) -> dict[str, float]:
        machine = psutil.cpu_times()
        idle_s = machine.idle + getattr(machine, "iowait", 0.0) + getattr(machine, "guest", 0.0)
        now = {name: cpu_s(processes) for name, processes in self._groups.items()}
        return now | {"wall": time.monotonic(), "machine": sum(machine) - idle_s}


def machine_facts() -> dict[str, object]:
    """Return cores and load: what a timing has to be read with."""
    return {
        "cores": os.cpu_count(),
        "load_1_5_15_min": [round(load, 2) for load in os.getloadavg()],
    }
