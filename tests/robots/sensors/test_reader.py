"""The reader: samples come out whole, in order; a dead sensor never looks alive, and comes back."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from fci_client import wait_until
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scripted import ScriptedSource

from uniforce_robots.sensors import faults
from uniforce_robots.sensors.reader import NS_PER_MS, ReaderLimits, SampleReader, Stamped, now_ns
from uniforce_vtla.errors import ContractError

LIMITS = ReaderLimits(capacity=16, frozen_after=5, silent_s=0.3, backoff_s=0.01, backoff_max_s=0.02)


def filled(count, capacity=8):
    reader = SampleReader(ScriptedSource(), ReaderLimits(capacity))
    reader.keep([Stamped(1_000_000 * (i + 1), np.array([i, -i], np.int32)) for i in range(count)])
    return reader


@examples(60)
@given(count=st.integers(0, 40), capacity=st.integers(2, 9), since=st.integers(-1, 45))
def test_what_is_kept_is_the_end_of_a_list(count, capacity, since):
    expected = list(range(count))[since + 1 :][-capacity:]
    later = [(stamp_ns, raw[0]) for stamp_ns, raw in filled(count, capacity).since(since)]
    assert later == [(1_000_000 * (i + 1), i) for i in expected]


def test_the_rate_is_measured():
    assert filled(50, 64).rate_hz() == pytest.approx(1000)
    assert filled(1).rate_hz() == 0


@pytest.mark.parametrize("limit", [{"silent_s": float("nan")}, {"frozen_after": -1}])
def test_limits_that_are_none(limit):
    with pytest.raises(ContractError, match=next(iter(limit))):
        ReaderLimits(**limit)


@pytest.fixture
def source():
    return ScriptedSource()


@pytest.fixture
def reader(source):
    reader = SampleReader(source, LIMITS)
    reader.start()
    reader.wait_newer(-1, 30_000)
    yield reader
    source.mode = "live"
    reader.stop()


def test_a_window_repeats_the_oldest_sample_instead_of_inventing_zeros(source, reader):
    source.mode = "silent"
    with pytest.raises(faults.StaleSensorError):
        reader.wait_newer(10**9, 50)  # waiting ends
    kept = reader.since(-1)
    kept = [kept[0]] * (16 - len(kept)) + kept
    stamps_ns, data = reader.window(16, 30_000)
    assert list(zip(stamps_ns, data, strict=True)) == kept
    with pytest.raises(ContractError, match="window"):
        reader.window(17, 30_000)


def test_a_sample_is_a_copy_with_its_age(source, reader):
    source.mode = "silent"
    time.sleep(0.03)
    sample = reader.newest(30_000)
    assert sample.age_ms >= 25 and sample.stamp_ns <= now_ns() - 25 * NS_PER_MS
    sample.raw[:] = -7
    assert reader.newest(30_000).raw[0] != -7


def test_waiting_ends_with_the_next_sample(source, reader):
    source.mode = "silent"
    time.sleep(0.01)
    before = reader.newest(30_000)
    threading.Timer(0.02, lambda: setattr(source, "mode", "live")).start()
    assert reader.wait_newer(before.index, 30_000).index > before.index


@pytest.mark.parametrize(
    "mode, kind, says",
    [
        ("gone", faults.LostSensorError, "Plug it in"),
        ("silent", faults.StaleSensorError, "scripted"),
        ("frozen", faults.FrozenSensorError, "same content"),
        ("bug", faults.LostSensorError, "scripted: expected a working driver, got ZeroDivision"),
        ("other", faults.WrongSensorError, "dtype"),
        ("none", faults.LostSensorError, "working driver"),
        ("text", faults.LostSensorError, "working driver"),
        ("no array", faults.LostSensorError, "working driver"),
    ],
)
def test_each_fault_has_its_error_and_recovers_by_itself(
    source, reader, outcome, recovers, mode, kind, says
):
    for _ in range(10):
        source.mode = mode
        assert says in str(outcome(lambda: reader.newest(100), kind))
        source.mode = "live"
        recovers(lambda: reader.newest(10_000))
    assert reader.reconnects >= (10 if mode == "gone" else 0)


def test_a_driver_that_hangs_gets_no_second_thread(source, reader, monkeypatch, outcome, recovers):
    monkeypatch.setattr("uniforce_robots.sensors.reader.JOIN_S", 0.05)
    source.mode = "hangs"
    outcome(lambda: reader.newest(30), faults.StaleSensorError)
    reader.stop()
    for _ in range(2):
        assert not reader.is_running
        with pytest.raises(faults.LostSensorError, match="hangs"):
            reader.start()
        reader.stop()
    assert source.opened == 1 and source.closed == 0
    source.mode = "live"
    source.returns.set()
    recovers(reader.start)
    assert (source.opened, source.closed) == (2, 1)


def test_starts_and_stops_from_many_threads_leave_one_reader(reader):
    def running():
        return sum(t.name == "reader of scripted" for t in threading.enumerate())

    threads = [threading.Thread(target=call) for call in (reader.start, reader.stop) * 20]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
        assert running() <= 1
    reader.stop()
    reader.start()
    reader.stop()
    assert not running()


def test_a_long_silence_reopens_the_device(source, reader):
    source.mode = "silent"
    wait_until(lambda: source.opened > 1, 4.0)
    assert source.closed >= 1


@pytest.mark.parametrize("mode, says", [("gone", "Plug it in"), ("bug", "ZeroDivisionError")])
def test_a_device_that_does_not_open_fails_at_once(source, mode, says):
    source.mode = mode
    reader = SampleReader(source, LIMITS)
    with pytest.raises(faults.LostSensorError, match=says):
        reader.start()
    with pytest.raises(faults.LostSensorError, match="not connected"):
        reader.newest(100)
    assert not reader.since(-1)


def test_a_start_waits_for_a_sample_of_its_own():
    reader = SampleReader(ScriptedSource(), replace(LIMITS, first_ms=5000.0))
    reader.keep([Stamped(now_ns() - 10**10, np.arange(1))])  # of an earlier connection
    reader.start()
    assert reader.newest(5000.0).index > 0
    reader.stop()


def test_stopping_closes_the_device_and_nothing_is_delivered_after(source, reader):
    reader.stop()
    assert source.closed == 1 and not reader.is_running
    with pytest.raises(faults.LostSensorError):
        reader.newest(10_000)
    reader.start()
    reader.wait_newer(source.counts.samples - 1, 30_000)


def test_a_backlog_is_an_error_only_while_it_lasts(source, monkeypatch):
    clock = [0.0]
    source.max_behind_s = 0.25
    monkeypatch.setattr("uniforce_robots.sensors.reader.time.monotonic", lambda: clock[0])
    for is_full in (True, True, False, True):  # one short read: it caught up
        assert source._must_read_on(is_full) == is_full
        clock[0] += 0.2
    clock[0] += 0.1
    with pytest.raises(faults.StaleSensorError, match="keeps up"):
        source._must_read_on(True)
