"""How much of a core this machine gives us: deadlines scale with it."""

import time

import pytest

from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.errors import SensorError

OUTCOME_S = 0.5  # a fault must show within this on a machine that has time for us
TIMES = 10  # each fault is injected
RATE_HZ = 100.0  # of the stand-ins of tests/robots/conftest.py


@pytest.fixture(scope="session")
def cpu_share():
    """Return the share of a core a busy loop got, 0 … 1: deadlines in milliseconds need one."""
    wall_s = time.perf_counter()
    cpu_s = time.process_time()
    while time.perf_counter() - wall_s < 0.3:
        pass
    return max((time.process_time() - cpu_s) / (time.perf_counter() - wall_s), 0.01)


@pytest.fixture
def outcome(cpu_share):
    """Return a function that calls another until it raises ``kind``, within a deadline.

    Another sensor error may come first: on a busy machine a sample grows stale before its cause is
    known.
    """

    def wait(ask, kind):
        deadline_s = time.monotonic() + OUTCOME_S / cpu_share
        while time.monotonic() < deadline_s:
            try:
                ask()
            except SensorError as error:
                if isinstance(error, kind):
                    return error
            time.sleep(0.005)
        pytest.fail(
            f"no {kind.__name__} within {OUTCOME_S / cpu_share:.1f} s (core share {cpu_share:.2f})"
        )

    return wait


@pytest.fixture
def recovers(cpu_share):
    def wait(ask):
        deadline_s = time.monotonic() + 3.0 + 1.0 / cpu_share
        while True:
            try:
                ask()
                return
            except SensorError:
                if time.monotonic() > deadline_s:
                    raise
            time.sleep(0.01)

    return wait


@pytest.fixture
def fails_and_recovers(outcome, recovers):
    """Return a function that breaks a stand-in ten times; sees its error, then a new sample.

    ``newest`` gives a sample younger than so many ms, ``wait_newer`` one after an index within so
    many ms.
    """

    def check(stand_in, fault, kind, newest, wait_newer, age_ms=100.0):
        for _ in range(TIMES):
            stand_in.inject(fault)
            error = outcome(lambda: newest(age_ms), kind)
            assert stand_in.sensor in str(error)
            stand_in.inject("none")
            recovers(lambda: newest(1e4))
            wait_newer(newest(1e4).index, 60_000)

    return check


@pytest.fixture
def costs_no_scan():
    """Return a function that injects a fault ten times; every scan must be the stand-in's."""
    truth = {scan.tobytes() for scan in taxel_cycle(Scene(), RATE_HZ)}

    def check(stand_in, fault, reader):
        for _ in range(TIMES):
            stand_in.inject(fault)
            before = reader.newest(1e4).index
            reader.wait_newer(before + 5, 30_000)
            assert all(scan.tobytes() in truth for _, scan in reader.since(before))
            stand_in.inject("none")

    return check


@pytest.fixture
def reader(source):
    """Read the source that a module names; there is a sample already."""
    reader = SampleReader(source, ReaderLimits(frozen_after=20, backoff_s=0.02, backoff_max_s=0.1))
    reader.start()
    reader.wait_newer(-1, 30_000)
    yield reader
    reader.stop()
