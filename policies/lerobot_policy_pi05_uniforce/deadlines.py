"""Whether a policy answers in time: every call's latency against the moment the action queue runs dry."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from uniforce_vtla.errors import ContractError, expected


class Deadlines:
    """Account of one episode's calls.

    A call that finds k actions still queued is due when they and the present step are over: k + 1 control periods. What
    comes later leaves the robot without a new action; those control steps are counted too.

    Args:
        control_hz: control rate of what the policy drives.

    Raises:
        ContractError: no positive rate.
    """

    def __init__(self, control_hz: float) -> None:
        if not control_hz > 0:
            raise ContractError(expected("control rate", "above 0 Hz", control_hz, "Give the robot's rate."))
        self.period_s = 1.0 / control_hz
        self.missed = 0  # calls
        self.empty_steps = 0  # control steps without a new action
        self._latencies_s: list[float] = []

    @contextmanager
    def call(self, queued: int) -> Iterator[None]:
        """Time the block as one call that found ``queued`` actions left."""
        start = time.perf_counter()
        yield
        self.record(time.perf_counter() - start, queued)

    def record(self, latency_s: float, queued: int) -> None:
        """Account for a call that took ``latency_s``."""
        self._latencies_s.append(latency_s)
        late_s = latency_s - (queued + 1) * self.period_s
        if late_s > 0:
            self.missed += 1
            self.empty_steps += math.ceil(late_s / self.period_s)

    def facts(self) -> dict[str, float]:
        """Return calls, missed deadlines, empty control steps and latencies [ms]; nothing before the first call."""
        if not self._latencies_s:
            return {}
        ms = 1e3 * np.asarray(self._latencies_s)
        return {
            "calls": len(ms),
            "missed_deadlines": self.missed,
            "empty_steps": self.empty_steps,
            "latency_p50_ms": float(np.percentile(ms, 50)),
            "latency_p95_ms": float(np.percentile(ms, 95)),
            "latency_max_ms": float(ms.max()),
        }
