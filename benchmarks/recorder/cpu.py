"""Who used the cores: CPU seconds of groups of processes over a stretch of time."""

import os
import time
from collections.abc import Iterable

import psutil


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
    """Cores used by each group from now until ``read``; the processes must be the same then.

    Args:
        groups: processes by name.
    """

    def __init__(self, groups: dict[str, list[psutil.Process]]) -> None:
        self._groups = groups
        self._begun = self._now()

    def read(self) -> dict[str, float]:
        """Return cores (1.0 is one whole core) by group, ``everything_else`` on this machine, and the mean load."""
        begun, ended = self._begun, self._now()
        wall_s = ended["wall"] - begun["wall"]
        used = {name: (ended[name] - begun[name]) / wall_s for name in self._groups}
        whole = (ended["machine"] - begun["machine"]) / wall_s
        rounded = {name: round(share, 3) for name, share in used.items()}
        return rounded | {"everything_else": round(max(whole - sum(used.values()), 0.0), 3)}

    def _now(self) -> dict[str, float]:
        machine = psutil.cpu_times()
        busy_s = sum(machine) - machine.idle - getattr(machine, "iowait", 0.0) - getattr(machine, "guest", 0.0)
        seconds = {name: cpu_s(processes) for name, processes in self._groups.items()}
        return seconds | {"wall": time.monotonic(), "machine": busy_s}


def machine_facts() -> dict[str, object]:
    """Return cores and load: what a timing has to be read with."""
    return {"cores": os.cpu_count(), "load_1_5_15_min": [round(load, 2) for load in os.getloadavg()]}
