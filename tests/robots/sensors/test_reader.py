"""The reader: a dead sensor never looks alive, and comes back by itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError, StaleSensorError
from uniforce_robots.sensors.reader import Backlog, ReaderLimits, SampleReader
from uniforce_robots.sensors.samples import SourceCounts, Stamped, now_ns
from uniforce_vtla.errors import SensorError

LIMITS = ReaderLimits(capacity=16, frozen_after=5, silent_s=0.3, backoff_s=0.01, backoff_max_s=0.02)


class Scripted:
    """A source whose behaviour a test sets while it runs."""

    name = "scripted"

    def __init__(self) -> None:
        self.mode, self.opened, self.closed, self.count, self.delay_s = "live", 0, 0, 0, 0.003

    @property
    def counts(self) -> SourceCounts:
        return SourceCounts(self.count)

    def open(self) -> None:
        if self.mode in ("gone", "absent"):
            raise LostSensorError("scripted: expected it, got nothing. Plug it in.")
        self.opened += 1

    def read(self) -> list[Stamped]:
        if self.mode == "gone":
            raise LostSensorError("scripted: expected data, got an unplugged cable. Plug it in.")
        if self.mode == "bug":
            raise ZeroDivisionError
        import time

        time.sleep(self.delay_s)
        if self.mode == "silent":
            return []
        self.count += self.mode != "frozen"
        return [Stamped(now_ns(), np.array([self.count], np.int64))]

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def pair():
    source = Scripted()
    reader = SampleReader(source, LIMITS)
    reader.start()
    reader.wait_newer(-1, 30_000)
    yield source, reader
    source.mode = "live"
    reader.stop()


def test_newest_sample_is_young(pair):
    _, reader = pair
    first = reader.newest(10_000)
    assert reader.wait_newer(first.index, 30_000).index > first.index


@pytest.mark.parametrize(
    ("mode", "kind", "says"),
    [
        ("gone", LostSensorError, "Plug it in"),
        ("silent", StaleSensorError, "scripted"),
        ("frozen", FrozenSensorError, "same content"),
        ("bug", LostSensorError, "reader died"),
    ],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_each_fault_has_its_error(pair, outcome: Callable, mode: str, kind: type, says: str):
    source, reader = pair
    source.mode = mode
    error = outcome(lambda: reader.newest(150), kind)
    assert says in str(error)


@pytest.mark.parametrize("mode", ["gone", "silent", "frozen"])
def test_it_recovers_by_itself(pair, outcome: Callable, recovers: Callable, mode: str):
    source, reader = pair
    for _ in range(10):
        source.mode = mode
        outcome(lambda: reader.newest(100))
        source.mode = "live"
        recovers(lambda: reader.newest(10_000))
    assert reader.reconnects >= (10 if mode == "gone" else 0)


def test_a_long_silence_reopens_the_device(pair, recovers: Callable):
    source, _ = pair
    source.mode = "silent"

    def reopened() -> None:
        if source.opened < 2:
            raise SensorError("not yet")

    recovers(reopened)
    assert source.closed >= 1


def test_waiting_for_a_silent_sensor_ends(pair):
    source, reader = pair
    source.mode = "silent"
    with pytest.raises(SensorError):
        reader.wait_newer(10**9, 50)


def test_opening_a_missing_device_fails_at_once():
    source = Scripted()
    source.mode = "absent"
    reader = SampleReader(source, LIMITS)
    with pytest.raises(LostSensorError, match="Plug it in"):
        reader.start()
    with pytest.raises(LostSensorError, match="not connected"):
        reader.newest(100)
    assert reader.since(-1).count == 0


def test_stopping_closes_the_device_and_nothing_is_delivered_after(pair):
    source, reader = pair
    reader.stop()
    assert source.closed == 1 and not reader.is_running
    with pytest.raises(LostSensorError):
        reader.newest(10_000)
    reader.start()
    reader.wait_newer(reader.since(-1).first_index, 30_000)


def test_a_backlog_is_an_error_only_while_it_lasts(monkeypatch: pytest.MonkeyPatch):
    clock = [0.0]
    monkeypatch.setattr("uniforce_robots.sensors.reader.time.monotonic", lambda: clock[0])
    backlog = Backlog("server", 100, 0.25)
    for size in (100, 200, 99, 100):  # one short read: it caught up
        assert backlog.more_waits(size) == (size >= 100)
        clock[0] += 0.2
    clock[0] += 0.1
    with pytest.raises(StaleSensorError, match="keeps up"):
        backlog.more_waits(100)
