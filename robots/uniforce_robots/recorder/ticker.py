"""A steady beat with absolute deadlines, and how well it was kept."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np


@dataclass(frozen=True)
class TickStats:
    """How a beat was kept."""

    ticks: int = 0  # how many there were
    mean_hz: float = 0.0  # over the whole stretch; 0 with fewer than two ticks
    jitter_p50_ms: float = 0.0  # of the ticks' delay after their deadlines: median
    jitter_p99_ms: float = 0.0  # 99th percentile
    jitter_max_ms: float = 0.0  # the longest
    missed: int = 0  # deadlines that passed without a tick, because the one before took too long

    @property
    def late_share(self) -> float:
        """Share of all deadlines that passed without a tick."""
        return self.missed / max(self.ticks + self.missed, 1)

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name, rounded for people."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


class Ticker:
    """Wait for the beats of ``rate_hz``; the first one is now. Not ``paced``, it never waits."""

    def __init__(
        self,
        rate_hz: float,
        paced: bool = True,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_s = 1 / rate_hz
        self._paced = paced
        self._clock = clock
        self._sleep = sleep
        self._due_s = clock()
        self._times: list[float] = []
        self._late_s: list[float] = []
        self._paused_s = 0.0
        self._missed = 0

    def resume(self) -> None:
        """Go on after a pause that shall not count: the next beat is one period away."""
        due_s = self._clock() + self._period_s
        self._paused_s += due_s - self._due_s
        self._due_s = due_s

    def wait(self) -> float:
        """Wait for the next beat; return how late it is in seconds."""
        now_s = self._clock()
        if self._paced and now_s < self._due_s:
            self._sleep(self._due_s - now_s)
            now_s = self._clock()
        late_s = max(now_s - self._due_s, 0.0) if self._paced else 0.0
        skipped = int(late_s / self._period_s)
        self._missed += skipped
        self._due_s += (1 + skipped) * self._period_s
        self._times.append(now_s)
        self._late_s.append(late_s)
        return late_s

    @property
    def stats(self) -> TickStats:
        """How the beat was kept since the start."""
        count = len(self._times)
        if count < 2:
            return TickStats(count, missed=self._missed)
        span_s = self._times[-1] - self._times[0] - self._paused_s
        p50, p99, most = np.percentile(np.array(self._late_s) * 1000, (50, 99, 100)).tolist()
        mean_hz = (count - 1) / span_s if span_s > 0 else 0.0
        return TickStats(count, mean_hz, p50, p99, most, self._missed)
