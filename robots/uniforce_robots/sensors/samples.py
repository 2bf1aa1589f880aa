"""Samples of a device and their times, and a ring of the newest ones: one writer, many readers.

Stamps are int64 nanoseconds of ``time.perf_counter_ns``: on Linux CLOCK_MONOTONIC, the clock V4L2 stamps its buffers
with, so that camera, taxels and arm can be laid side by side.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple, Protocol

import numpy as np

from uniforce_robots.sensors.faults import WrongSensorError
from uniforce_vtla.errors import ContractError, expected

NS_PER_MS = 1e6
NS_PER_S = 1e9


def now_ns() -> int:
    """Return the host's monotonic time, the clock of every stamp here."""
    return time.perf_counter_ns()


class Stamped(NamedTuple):
    """A sample as a source delivers it: when (``now_ns`` clock) and what, an array of its own."""

    stamp_ns: int
    data: np.ndarray


@dataclass(frozen=True)
class SourceCounts:
    """What a source met since it was made; reconnecting doesn't reset it.

    Attributes:
        samples: whole samples delivered.
        lost: samples that began and never became whole.
        bad: pieces that could not be understood: lines, frames, images.
    """

    samples: int = 0
    lost: int = 0
    bad: int = 0


class SampleSource(Protocol):
    """One device.  All calls come from one thread; ``read`` blocks for a tenth of a second or so at most."""

    name: str

    @property
    def counts(self) -> SourceCounts:
        """What was met so far."""
        ...

    def open(self) -> None:
        """Connect; raise SensorError where that fails, within seconds."""
        ...

    def read(self) -> list[Stamped]:
        """Return what came since the last call, oldest first, maybe nothing; raise SensorError once lost."""
        ...

    def close(self) -> None:
        """Let go of the device; never raises, may be called twice."""
        ...


@dataclass(frozen=True)
class Sample:
    """One sample: its ``index`` since the ring began, when it was taken, and a copy of its data."""

    index: int
    stamp_ns: int
    data: np.ndarray

    def age_ms(self) -> float:
        """Return how old the sample is now."""
        return (now_ns() - self.stamp_ns) / NS_PER_MS


@dataclass(frozen=True)
class Window:
    """Samples in order of time, the newest last.

    Attributes:
        first_index: index of the first real sample.
        count: real samples; they fill the end of the arrays.
        stamps_ns: (size,) int64; 0 where there was no sample.
        data: (size, ...); repeats the oldest real sample where there was none, so that nothing is made up.
    """

    first_index: int
    count: int
    stamps_ns: np.ndarray
    data: np.ndarray


class SampleRing:
    """Keeps the newest ``capacity`` samples; 1024 taxel scans are 2 s at 500 Hz, 8 frames of 1280×720 are 22 MB."""

    def __init__(self, capacity: int) -> None:
        self._kept: deque[Stamped] = deque(maxlen=capacity)
        self._count = 0  # samples ever written
        self._changed = threading.Condition()

    def push(self, sample: Stamped) -> None:
        """Keep a sample, whose array is the ring's from now on, and wake who waits.

        Raises:
            WrongSensorError: another shape or dtype than before.
        """
        form = sample.data.dtype, sample.data.shape
        with self._changed:
            before = self._kept[-1].data if self._kept else sample.data
            if form != (before.dtype, before.shape):
                do = "Keep one setting per connection."
                raise WrongSensorError(expected("sample", (before.dtype, before.shape), form, do))
            self._kept.append(sample)
            self._count += 1
            self._changed.notify_all()

    def newest(self) -> Sample | None:
        """Return the newest sample, or None before the first."""
        with self._changed:
            return self._newest()

    def wait_newer(self, index: int, timeout_s: float) -> Sample | None:
        """Return the newest sample once there is one after ``index``; None if none came in ``timeout_s``."""
        with self._changed:
            in_time = self._changed.wait_for(lambda: self._count - 1 > index, timeout_s)
            return self._newest() if in_time else None

    def window(self, size: int) -> Window:
        """Return the newest ``size`` samples in arrays of exactly that length; see ``Window`` for the padding.

        Raises:
            ContractError: a size outside 1 … capacity, or no sample yet.
        """
        capacity = self._kept.maxlen
        if not 1 <= size <= (capacity or 0):
            raise ContractError(expected("window", f"1 … {capacity} samples", size, "Ask for fewer."))
        window = self._last(size)
        if not window.count:
            raise ContractError(expected("window", "a sample", "none yet", "Wait for the first sample."))
        missing = [(size - window.count, 0)] + [(0, 0)] * (window.data.ndim - 1)
        stamps_ns, data = np.pad(window.stamps_ns, missing[0]), np.pad(window.data, missing, mode="edge")
        return Window(window.first_index, window.count, stamps_ns, data)

    def since(self, index: int) -> Window:
        """Return every sample after ``index`` that is still kept; ``first_index`` shows how many are not."""
        return self._last(max(self._count - 1 - index, 0))

    def rate_hz(self, over_s: float = 2.0) -> float:
        """Return the measured rate over the newest ``over_s`` seconds of samples; 0 with fewer than two."""
        with self._changed:
            stamps_ns = np.array([sample.stamp_ns for sample in self._kept])
        if len(stamps_ns) < 2:
            return 0.0
        recent = stamps_ns[stamps_ns >= stamps_ns[-1] - over_s * NS_PER_S]
        span_s = float(recent[-1] - recent[0]) / NS_PER_S
        return (len(recent) - 1) / span_s if span_s > 0 else 0.0

    def _newest(self) -> Sample | None:
        if not self._kept:
            return None
        stamp_ns, data = self._kept[-1]
        return Sample(self._count - 1, stamp_ns, data.copy())

    def _last(self, size: int) -> Window:
        """Return the newest ``size`` samples, fewer where fewer are kept."""
        with self._changed:
            kept = list(islice(reversed(self._kept), size))[::-1]
            first = self._count - len(kept)
        stamps_ns = np.array([sample.stamp_ns for sample in kept], np.int64)
        data = np.stack([sample.data for sample in kept]) if kept else np.empty((0,))
        return Window(first, len(kept), stamps_ns, data)
