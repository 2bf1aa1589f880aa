"""A thread that keeps one device's newest samples at hand, and never lets a dead sensor look alive.

The newest sample is young enough, or an error names the sensor and the reason.

Stamps are int64 nanoseconds of ``time.perf_counter_ns``: on Linux CLOCK_MONOTONIC, V4L2's own
clock, so that camera, taxels and arm can be compared.
"""

import logging
import threading
import time
import zlib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from uniforce_robots.sensors import faults
from uniforce_vtla.errors import ContractError, SensorError, TeleoperatorError, expected
from uniforce_vtla.options import Range

log = logging.getLogger(__name__)
NS_PER_MS = 1e6
NS_PER_S = 1e9
RATE_OVER_S = 2.0
JOIN_S = 3.0  # a driver may sit in a blocking read that long; see the capture's read time-outs
now_ns = time.perf_counter_ns  # the clock of every stamp


class Stamped(NamedTuple):
    """A sample as a source delivers it: when it was taken, and an array of its own."""

    stamp_ns: int
    raw: np.ndarray


@dataclass
class SourceCounts:
    """Counts of a source since it was made; reconnecting doesn't reset them."""

    samples: int = 0  # whole samples delivered
    lost: int = 0  # begun and never whole, or left out for a newer one
    bad: int = 0  # pieces that could not be understood: lines, frames, images


class SampleSource(ABC):
    """One device, used by one thread; errors call it ``name``."""

    max_behind_s = 1.0  # how long reading may lag behind before that is an error

    def __init__(self, name: str) -> None:
        self.name = name
        self.counts = SourceCounts()
        # what a camera's driver said each setting was
        self.settings_read_back: dict[str, float] = {}
        self._closing = ExitStack()
        self._behind_since_s = float("inf")

    def open(self) -> None:
        """Connect anew; raise SensorError within seconds where that fails, leaving nothing open."""
        self.close()
        with ExitStack() as undo:
            self._connect(undo)
            self._closing = undo.pop_all()

    def close(self) -> None:
        """Let go of the device; never raises, may be called twice."""
        try:
            self._closing.close()
        except Exception:  # a driver may raise anything
            log.exception("%s: its driver failed while it was closed", self.name)

    @abstractmethod
    def _connect(self, undo: ExitStack) -> None:
        """Connect, and leave with ``undo`` what closes it again."""

    @abstractmethod
    def read(self) -> list[Stamped]:
        """Return what came to an open device since the last call, oldest first, maybe nothing.

        Blocks for a tenth of a second or so at most.

        Raises LostSensorError: it is gone; ProtocolError: bytes that can't be understood;
        WrongSensorError: frames of another size, no such sensor, not 16 taxels;
        SimulatedSensorError: a server says that its bus is simulated; StaleSensorError: data come
        faster than they are read, so that their stamps would be wrong.
        """

    def _must_read_on(self, is_full: bool) -> bool:
        """Return whether the last read was full, so that more must be read before stamping.

        Data that waited in the kernel must not pass for new: while reads are full the newest sample
        grows old, as it should. A reader that never catches up is an error.
        """
        if not is_full:
            self._behind_since_s = float("inf")
            return False
        now_s = time.monotonic()
        self._behind_since_s = min(self._behind_since_s, now_s)
        behind_s = now_s - self._behind_since_s
        if behind_s > self.max_behind_s:
            self._behind_since_s = float("inf")
            do = "Free the CPU of this machine; what waited is thrown away by opening anew."
            came = f"a queue for {behind_s:.2f} s"
            raise faults.StaleSensorError(expected(self.name, "a reader that keeps up", came, do))
        return True


@dataclass(frozen=True)
class Sample:
    """One sample."""

    raw: np.ndarray  # a copy: (H, W, 3) uint8 RGB of a camera, (16, 3) uint16 counts of a uSkin
    index: int  # since the reader was made; a gap shows how many were left out
    stamp_ns: int  # when it was taken, host's monotonic clock
    age_ms: float  # how old it was when asked for


@dataclass(frozen=True)
class ReaderLimits:
    """How much is kept and what counts as dead."""

    capacity: int = 1024  # samples: 2 s of taxels at 500 Hz; 8 frames of 1280×720 are 22 MB
    frozen_after: int = 10  # samples of one content in a row; 0 never looks
    first_ms: float = 0.0  # the first sample must come within; 0 doesn't wait for it
    silent_s: float = 2.0  # without any sample for so long, the device is opened anew
    backoff_s: float = 0.1  # first wait before reopening; doubles
    backoff_max_s: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            Range(0, float("inf")).check(name, value)


class SampleReader:
    """Read ``source`` in the background from ``start`` to ``stop``; count its ``reconnects``."""

    def __init__(self, source: SampleSource, limits: ReaderLimits | None = None) -> None:
        self._source = source
        self._limits = limits or ReaderLimits()
        self._kept: deque[Stamped] = deque(maxlen=self._limits.capacity)
        self._changed = threading.Condition()
        self._turn = threading.RLock()  # one start or stop at a time
        self._stop = threading.Event()  # of the newest start; its thread never sees another one
        self._thread: threading.Thread | None = None
        self._fault: SensorError | None = None
        self._received = self._last_sample_ns = self._last_crc = self._repeats = 0
        self.name = source.name
        self.reconnects = 0

    @property
    def counts(self) -> SourceCounts:
        """Samples delivered, lost and bad so far."""
        return replace(self._source.counts)

    @property
    def is_running(self) -> bool:
        """Whether the thread is there; the sensor itself may be lost meanwhile."""
        return self._has_thread and not self._stop.is_set()

    @property
    def _has_thread(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Open the device, then read on in the background.

        Raises SensorError: it can't be opened; LostSensorError: the driver still hangs in a read
        begun before the last ``stop``.
        """
        with self._turn:
            if self.is_running:
                return
            if self._has_thread:
                do = "Replug the device, then try again."
                raise faults.LostSensorError(
                    expected(self.name, "a driver that returns", "one that hangs", do)
                )
            self._fault = None
            self._repeats = 0
            before = self._received - 1
            with self._translated():
                self._source.open()
            self._last_sample_ns = now_ns()
            self._stop = threading.Event()
            name = f"reader of {self.name}"
            self._thread = threading.Thread(
                target=self._run, args=(self._stop,), name=name, daemon=True
            )
            self._thread.start()
        with ExitStack() as undo:
            undo.callback(self.stop)  # a half-connected device would keep its port
            if self._limits.first_ms:
                self.wait_newer(before, self._limits.first_ms)
            undo.pop_all()

    def stop(self) -> None:
        """Stop reading and let go of the device; the samples read so far stay."""
        with self._turn:
            self._stop.set()
            if self._thread is not None:
                self._thread.join(JOIN_S)
            if self._has_thread:
                log.warning(
                    "%s: its driver doesn't return; it is closed as soon as it does", self.name
                )
            else:
                self._thread = None

    def newest(self, max_age_ms: float) -> Sample:
        """Return the newest sample without waiting.

        Raises LostSensorError: not connected, or gone; another SensorError where the cause has its
        own class; FrozenSensorError: the content hasn't changed for ``frozen_after`` samples;
        StaleSensorError: no sample yet, or older than ``max_age_ms``.
        """
        return self.wait_newer(-1, max_age_ms, wait_ms=0.0)

    def wait_newer(self, index: int, max_age_ms: float, wait_ms: float | None = None) -> Sample:
        """Wait for the newest sample after ``index``, for as long as it may be old.

        Raises SensorError: as ``newest``, where no sample comes in time.
        """
        if wait_ms is None:
            wait_ms = max_age_ms
        with self._changed:
            in_time = self._changed.wait_for(lambda: self._received - 1 > index, wait_ms / 1e3)
            newest = self._received - 1
            if in_time:
                stamp_ns, raw = self._kept[-1]
        self._check_alive()
        do = "Stop pressing; check cable, USB load and the sensor's rate."
        if not in_time:
            raise faults.StaleSensorError(
                expected(self.name, f"a sample within {max_age_ms:g} ms", "none", do)
            )
        age_ms = (now_ns() - stamp_ns) / NS_PER_MS
        if age_ms > max_age_ms:
            wanted = f"a sample younger than {max_age_ms:g} ms"
            came = f"{age_ms:.0f} ms"
            raise faults.StaleSensorError(expected(self.name, wanted, came, do))
        return Sample(raw.copy(), newest, stamp_ns, age_ms)

    def window(self, size: int, max_age_ms: float) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps (size,) int64 ns and data (size, ...) of the newest samples, in order.

        Where fewer are kept the oldest is repeated.

        Raises ContractError: a size outside 1 … capacity; SensorError: as ``newest``.
        """
        if not 1 <= size <= self._limits.capacity:
            raise ContractError(
                expected("window", f"1 … {self._limits.capacity} samples", size, "Ask for fewer.")
            )
        self.newest(max_age_ms)
        with self._changed:
            kept = list(self._kept)[-size:]
        kept = [kept[0]] * (size - len(kept)) + kept
        stamps_ns, raws = zip(*kept, strict=True)
        return np.array(stamps_ns), np.stack(raws)

    def since(self, index: int) -> list[Stamped]:
        """Return every sample after ``index`` that is still kept, the newest last."""
        with self._changed:
            kept = list(self._kept)
            later = min(max(self._received - 1 - index, 0), len(kept))
        return kept[len(kept) - later :]

    def rate_hz(self) -> float:
        """Return the rate over the newest ``RATE_OVER_S`` of samples; 0 with fewer than two."""
        stamps_ns = np.array([stamp_ns for stamp_ns, _ in self.since(-1)])
        recent = stamps_ns[stamps_ns >= stamps_ns.max(initial=0) - RATE_OVER_S * NS_PER_S]
        if len(set(recent)) < 2:
            return 0.0
        return (len(recent) - 1) * NS_PER_S / np.ptp(recent)

    # -- the thread ----------------------------------------------------------------------------

    def _run(self, stop: threading.Event) -> None:
        try:
            while not stop.is_set():
                self._read_or_reopen(stop)
        finally:
            self._source.close()

    @contextmanager
    def _translated(self) -> Iterator[None]:
        """Turn whatever a driver raises into a SensorError."""
        try:
            yield
        except (SensorError, TeleoperatorError):
            raise
        except Exception as error:
            came = f"{type(error).__name__}: {error}"
            raise faults.LostSensorError(
                expected(self.name, "a working driver", came, "Replug the device.")
            ) from error

    def _read_or_reopen(self, stop: threading.Event) -> None:
        try:
            with self._translated():
                self.keep(self._source.read())
            silent_s = (now_ns() - self._last_sample_ns) / NS_PER_S
            if silent_s > self._limits.silent_s:
                do = "Opening it anew; check power, cable and bus."
                raise faults.StaleSensorError(
                    expected(self.name, "samples", f"none for {silent_s:.1f} s", do)
                )
        except SensorError as error:
            if self._fault is None:  # once per loss, not once per attempt
                log.warning("%s: %s", self.name, error)
            self._fault = error
            self._source.close()
            self._reopen(stop)

    def _reopen(self, stop: threading.Event) -> None:
        wait_s = self._limits.backoff_s
        while not stop.wait(wait_s):
            wait_s = min(2 * wait_s, self._limits.backoff_max_s)
            try:
                with self._translated():
                    self._source.open()
            except SensorError as error:
                self._fault = error
                continue
            self.reconnects += 1
            self._last_sample_ns, self._repeats = now_ns(), 0
            return

    def keep(self, samples: list[Stamped]) -> None:
        """Keep samples and their arrays; WrongSensorError: another shape or dtype than before."""
        for sample in samples:
            crc = zlib.crc32(np.ascontiguousarray(sample.raw))
            if crc == self._last_crc:
                self._repeats += 1
            else:
                self._repeats = 0
            self._last_crc = crc
            form = sample.raw.dtype, sample.raw.shape
            with self._changed:
                before = self._kept[-1].raw if self._kept else sample.raw
                if form != (before.dtype, before.shape):
                    do = "Keep one setting per connection."
                    raise faults.WrongSensorError(
                        expected("sample", (before.dtype, before.shape), form, do)
                    )
                self._kept.append(sample)
                self._received += 1
                self._changed.notify_all()
        if samples:
            self._last_sample_ns = now_ns()
            self._fault = None  # an open port proves nothing: the fault ends with the first sample

    def _check_alive(self) -> None:
        if not self.is_running:
            came = "not connected" if self._thread is None else "one that ends"
            raise faults.LostSensorError(
                expected(self.name, "a running reader", came, "Call connect().")
            )
        fault = self._fault
        if fault is not None:
            text = str(fault)
            if self.name not in text:  # a socket knows its address, not whose finger it serves
                text = f"{self.name}: {text}"
            raise type(fault)(text) from fault
        if self._limits.frozen_after and self._repeats >= self._limits.frozen_after:
            came = f"the same content {self._repeats + 1} times in a row"
            raise faults.FrozenSensorError(
                expected(self.name, "changing samples", came, "Replug the sensor.")
            )
