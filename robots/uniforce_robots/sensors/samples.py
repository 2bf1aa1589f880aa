"""A preallocated ring of timestamped samples: one writer, many readers, no allocation while running.

Stamps are int64 nanoseconds of ``time.perf_counter_ns``: on Linux CLOCK_MONOTONIC, the clock V4L2 stamps its buffers
with, so that camera, taxels and arm can be laid side by side.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np

from uniforce_vtla.errors import ContractError, expected

NS_PER_MS = 1e6
NS_PER_S = 1e9


def now_ns() -> int:
    """Return the host's monotonic time, the clock of every stamp here."""
    return time.perf_counter_ns()


@dataclass(frozen=True)
class Sample:
    """One sample: its ``index`` since the ring began, when it was taken, and a copy of its data."""

    index: int
    stamp_ns: int
    data: np.ndarray

    def age_ms(self, at_ns: int | None = None) -> float:
        """Return how old the sample is now, or was at ``at_ns``."""
        return ((now_ns() if at_ns is None else at_ns) - self.stamp_ns) / NS_PER_MS


@dataclass(frozen=True)
class Window:
    """Samples in order of time, the newest last.

    Attributes:
        first_index: index of the first real sample.
        count: real samples; they fill the end of the arrays.
        missed: samples asked for that had already been overwritten.
        stamps_ns: (size,) int64; 0 where there was no sample.
        data: (size, ...); repeats the oldest real sample where there was none, so that nothing is made up.
    """

    first_index: int
    count: int
    missed: int
    stamps_ns: np.ndarray
    data: np.ndarray


class SampleRing:
    """Keeps the newest ``capacity`` samples of one shape and dtype.

    Args:
        shape: of one sample.
        dtype: of one sample.
        capacity: samples kept; 1024 taxel scans are 2 s at 500 Hz, 8 frames of 1280×720 are 22 MB.

    Raises:
        ContractError: a capacity below 2.
    """

    def __init__(self, shape: tuple[int, ...], dtype: np.typing.DTypeLike, capacity: int) -> None:
        if capacity < 2:
            raise ContractError(expected("ring", "room for 2 samples", capacity, "Give more capacity."))
        self.capacity = capacity
        self._data = np.zeros((capacity, *shape), dtype)
        self._stamps_ns = np.zeros(capacity, np.int64)
        self._count = 0  # samples ever written
        self._changed = (
            threading.Condition()
        )  # numpy copies may release the GIL: readers must not see half a sample

    @property
    def count(self) -> int:
        """Samples written so far; the next one's index."""
        return self._count

    def push(self, stamp_ns: int, data: np.ndarray) -> None:
        """Store a copy of ``data`` and wake who waits.

        Raises:
            ContractError: another shape or dtype than the ring's: broadcasting would store nonsense.
        """
        if data.shape != self._data.shape[1:] or data.dtype != self._data.dtype:
            wanted = f"{self._data.dtype} {self._data.shape[1:]}"
            raise ContractError(
                expected("sample", wanted, f"{data.dtype} {data.shape}", "Keep one setting per connection.")
            )
        with self._changed:
            slot = self._count % self.capacity
            self._data[slot] = data
            self._stamps_ns[slot] = stamp_ns
            self._count += 1
            self._changed.notify_all()

    def newest(self) -> Sample | None:
        """Return the newest sample, or None before the first."""
        with self._changed:
            return self._copy(self._count - 1) if self._count else None

    def wait_newer(self, index: int, timeout_s: float) -> Sample | None:
        """Return the newest sample once there is one after ``index``; None if none came in ``timeout_s``."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._count - 1 > index, timeout_s):
                return None
            return self._copy(self._count - 1)

    def window(self, size: int) -> Window:
        """Return the newest ``size`` samples in arrays of exactly that length; see ``Window`` for the padding.

        Raises:
            ContractError: a size outside 1 … capacity, or no sample yet.
        """
        if not 1 <= size <= self.capacity:
            raise ContractError(expected("window", f"1 … {self.capacity} samples", size, "Ask for fewer."))
        with self._changed:
            if not self._count:
                raise ContractError(expected("window", "a sample", "none yet", "Wait for the first sample."))
            first = max(self._count - size, 0)
            indices = np.maximum(np.arange(self._count - size, self._count), first)
            stamps = self._stamps_ns[indices % self.capacity]
            real = self._count - first
            stamps[: size - real] = 0
            return Window(first, real, 0, stamps, self._data[indices % self.capacity])

    def since(self, index: int) -> Window:
        """Return every sample after ``index`` that is still kept; ``missed`` tells how many are not."""
        with self._changed:
            first = max(index + 1, self._count - self.capacity, 0)
            slots = np.arange(first, self._count) % self.capacity
            missed = max(first - (index + 1), 0)
            return Window(first, len(slots), missed, self._stamps_ns[slots], self._data[slots])

    def rate_hz(self, over_s: float = 2.0) -> float:
        """Return the measured rate over the newest ``over_s`` seconds of samples; 0 with fewer than two."""
        with self._changed:
            kept = min(self._count, self.capacity)
            stamps = self._stamps_ns[np.arange(self._count - kept, self._count) % self.capacity]
        if kept < 2:
            return 0.0
        recent = stamps[stamps >= stamps[-1] - over_s * NS_PER_S]
        span_s = float(recent[-1] - recent[0]) / NS_PER_S
        return (len(recent) - 1) / span_s if span_s > 0 else 0.0

    def _copy(self, index: int) -> Sample:
        slot = index % self.capacity
        return Sample(index, int(self._stamps_ns[slot]), self._data[slot].copy())
