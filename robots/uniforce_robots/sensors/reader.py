"""A thread that keeps one device's newest samples at hand, and never lets a dead sensor look alive.

Whoever asks for the newest sample gets one that is young enough, or an error that names the sensor and the reason.  The
age is judged by the asker: a driver stuck in the kernel can't hide behind its last sample.
"""

from __future__ import annotations

import logging
import threading
import time
import zlib
from dataclasses import dataclass

import numpy as np

from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError, StaleSensorError
from uniforce_robots.sensors.samples import (
    NS_PER_S,
    Sample,
    SampleRing,
    SampleSource,
    SourceCounts,
    Stamped,
    Window,
    now_ns,
)
from uniforce_vtla.errors import SensorError, expected

log = logging.getLogger(__name__)

MAX_BEHIND_S = 1.0
JOIN_S = 3.0  # a driver may sit in a blocking read that long; see the capture's read time-outs


@dataclass(frozen=True)
class ReaderLimits:
    """How much is kept and what counts as dead."""

    capacity: int = 1024  # samples in the ring
    frozen_after: int = 10  # samples of one content in a row; 0 never looks
    silent_s: float = 2.0  # without any sample for so long, the device is opened anew
    backoff_s: float = 0.1  # first wait before reopening; doubles
    backoff_max_s: float = 2.0


class SampleReader:
    """Reads ``source`` in the background from ``start`` to ``stop``.

    Attributes:
        reconnects: how often the device was lost and found again.
    """

    def __init__(self, source: SampleSource, limits: ReaderLimits | None = None) -> None:
        self._source = source
        self._limits = limits or ReaderLimits()
        self._ring = SampleRing(self._limits.capacity)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._fault: SensorError | None = None
        self._last_sample_ns = 0
        self._last_crc = 0
        self._repeats = 0
        self.reconnects = 0

    # -- for whoever wants samples ----------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name of the device, as it appears in errors."""
        return self._source.name

    @property
    def counts(self) -> SourceCounts:
        """Samples delivered, lost and bad so far."""
        return self._source.counts

    @property
    def is_running(self) -> bool:
        """Whether the thread is there; the sensor itself may be lost meanwhile."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Open the device here, so that a failure is the caller's, then read on in the background.

        Raises:
            SensorError: the device can't be opened.
        """
        if self.is_running:
            return
        self._stop.clear()
        self._fault, self._repeats = None, 0
        self._source.open()
        self._last_sample_ns = now_ns()
        self._thread = threading.Thread(target=self._run, name=f"reader of {self.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and let go of the device; the samples read so far stay."""
        self._stop.set()
        if self._thread is None:
            return
        self._thread.join(JOIN_S)
        if self._thread.is_alive():
            log.warning("%s: its driver doesn't return; it is closed as soon as it does", self.name)
        self._thread = None

    def newest(self, max_age_ms: float) -> Sample:
        """Return the newest sample without waiting.

        Raises:
            LostSensorError: not connected, or gone; another SensorError where the cause has its own class.
            FrozenSensorError: the content hasn't changed for ``frozen_after`` samples.
            StaleSensorError: no sample yet, or older than ``max_age_ms``.
        """
        self._check_alive()
        return self._checked(self._ring.newest(), max_age_ms)

    def wait_newer(self, index: int, timeout_ms: float) -> Sample:
        """Return the newest sample after ``index``, waiting for it.

        Raises:
            SensorError: as ``newest``, where no sample comes within ``timeout_ms``.
        """
        sample = self._ring.wait_newer(index, timeout_ms / 1e3)
        self._check_alive()
        return self._checked(sample, timeout_ms)

    def window(self, size: int, max_age_ms: float) -> Window:
        """Return the newest ``size`` samples; raises as ``newest`` does."""
        self.newest(max_age_ms)
        return self._ring.window(size)

    def since(self, index: int) -> Window:
        """Return every kept sample after ``index``."""
        return self._ring.since(index)

    def rate_hz(self, over_s: float = 2.0) -> float:
        """Return the measured rate; 0 before the second sample."""
        return self._ring.rate_hz(over_s)

    # -- the thread -------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._read_or_reopen()
        finally:
            self._source.close()

    def _read_or_reopen(self) -> None:
        try:
            self._take(self._source.read())
            self._check_silence()
        except SensorError as error:
            if self._fault is None:  # once per loss, not once per attempt
                log.warning("%s: %s", self.name, error)
            self._fault = error
            self._source.close()
            self._reopen()

    def _reopen(self) -> None:
        wait_s = self._limits.backoff_s
        while not self._stop.wait(wait_s):
            wait_s = min(2 * wait_s, self._limits.backoff_max_s)
            try:
                self._source.open()
            except SensorError as error:
                self._fault = error
                continue
            self.reconnects += 1
            self._last_sample_ns, self._repeats = now_ns(), 0
            return

    def _take(self, samples: list[Stamped]) -> None:
        for sample in samples:
            self._count_repeats(sample.data)
            self._ring.push(sample)
        if samples:
            self._last_sample_ns = now_ns()
            self._fault = None  # an open port proves nothing: the fault ends with the first sample

    def _count_repeats(self, data: np.ndarray) -> None:
        crc = zlib.crc32(np.ascontiguousarray(data))
        same = crc == self._last_crc
        self._repeats, self._last_crc = (self._repeats + 1 if same else 0), crc

    def _check_silence(self) -> None:
        silent_s = (now_ns() - self._last_sample_ns) / NS_PER_S
        if silent_s > self._limits.silent_s:
            do = "Opening it anew; check power, cable and bus."
            raise StaleSensorError(expected(self.name, "samples", f"none for {silent_s:.1f} s", do))

    # -- judging ----------------------------------------------------------------------------------------

    def _check_alive(self) -> None:
        if not self.is_running:
            came = "not connected" if self._thread is None else "its reader died"
            raise LostSensorError(expected(self.name, "a running reader", came, "Call connect()."))
        fault = self._fault
        if fault is not None:
            text = str(fault)  # a socket knows its address, not whose finger it serves
            raise type(fault)(text if self.name in text else f"{self.name}: {text}") from fault
        if self._limits.frozen_after and self._repeats >= self._limits.frozen_after:
            came = f"the same content {self._repeats + 1} times in a row"
            raise FrozenSensorError(expected(self.name, "changing samples", came, "Replug the sensor."))

    def _checked(self, sample: Sample | None, max_age_ms: float) -> Sample:
        do = "Stop pressing; check cable, USB load and the sensor's rate."
        if sample is None:
            raise StaleSensorError(expected(self.name, f"a sample within {max_age_ms:g} ms", "none", do))
        age_ms = sample.age_ms()
        if age_ms > max_age_ms:
            wanted, came = f"a sample younger than {max_age_ms:g} ms", f"{age_ms:.0f} ms"
            raise StaleSensorError(expected(self.name, wanted, came, do))
        return sample


class Backlog:
    """Decides whether to read on: data that waited in the kernel must not pass for new.

    Whoever reads full buffers goes on reading until one isn't full, and only then stamps and delivers: meanwhile the
    newest sample grows old, as it should.  A reader that never catches up is an error.

    Args:
        name: how errors call the sensor.
        full_bytes: a read of so many bytes means that more is waiting.
        max_behind_s: how long that may go on.
    """

    def __init__(self, name: str, full_bytes: int, max_behind_s: float = MAX_BEHIND_S) -> None:
        self._name, self._full, self._max_s = name, full_bytes, max_behind_s
        self._since_s: float | None = None

    def more_waits(self, size: int) -> bool:
        """Return whether a read of ``size`` bytes was full, so that there is more to read at once.

        Raises:
            StaleSensorError: full reads only, for longer than allowed.
        """
        now_s = time.monotonic()
        if size < self._full:
            self._since_s = None
            return False
        if self._since_s is None:
            self._since_s = now_s
        behind_s = now_s - self._since_s
        if behind_s > self._max_s:
            self._since_s = None
            do = "Free the CPU of this machine; what waited is thrown away by opening anew."
            came = f"a queue for {behind_s:.2f} s"
            raise StaleSensorError(expected(self._name, "a reader that keeps up", came, do))
        return True
