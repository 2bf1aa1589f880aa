"""Stand-ins shared by all device tests, and how much of a core this machine gives us: deadlines scale with it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

# scripted: importlib mode gives test folders no package
sys.path.insert(0, str(Path(__file__).parent))

from uniforce_robots.standins.process import StandIn
from uniforce_vtla.errors import SensorError

OUTCOME_S = 0.5  # a fault must show within this on a machine that has time for us
TIMES = 10  # each fault is injected
RATE_HZ = 100.0  # enough for faults; the rate test starts its own at 500


@pytest.fixture(scope="session")
def cpu_share() -> float:
    """Return the share of a core a busy loop got, 0 … 1: a machine that starves us can't be held to milliseconds."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    while time.perf_counter() - wall_s < 0.3:
        pass
    return max((time.process_time() - cpu_s) / (time.perf_counter() - wall_s), 0.01)


@pytest.fixture
def outcome(cpu_share: float) -> Callable[..., SensorError]:
    """Return a function that calls another until it raises ``kind``, and fails when that takes too long.

    Another sensor error may come first: on a busy machine a sample grows stale before its cause is known.
    """

    def wait(ask: Callable[[], object], kind: type[SensorError] = SensorError) -> SensorError:
        deadline_s = time.monotonic() + OUTCOME_S / cpu_share
        while time.monotonic() < deadline_s:
            try:
                ask()
            except SensorError as error:
                if isinstance(error, kind):
                    return error
            time.sleep(0.005)
        pytest.fail(f"no {kind.__name__} within {OUTCOME_S / cpu_share:.1f} s (core share {cpu_share:.2f})")

    return wait


@pytest.fixture
def recovers(cpu_share: float) -> Callable[[Callable[[], object]], None]:
    """Return a function that calls another until it stops raising."""

    def wait(ask: Callable[[], object]) -> None:
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
def fails_and_recovers(outcome: Callable, recovers: Callable) -> Callable[..., None]:
    """Return a function that breaks a stand-in ten times, and sees each time the named error, then a new sample.

    ``newest`` gives a sample younger than so many ms, ``wait_newer`` one after an index within so many ms.
    """

    def check(
        stand_in: StandIn,
        fault: str,
        kind: type[SensorError],
        newest: Callable,
        wait_newer: Callable,
        age_ms: float,
    ) -> None:
        for _ in range(TIMES):
            stand_in.inject(fault)
            error = outcome(lambda: newest(age_ms), kind)
            assert stand_in.sensor in str(error)
            stand_in.inject("none")
            recovers(lambda: newest(1e4))
            wait_newer(newest(1e4).index, 60_000)

    return check


def _running(name: str, sensor: str, *options: str) -> Any:
    """Return a session's fixture: a stand-in of its own process, started once."""

    @pytest.fixture(scope="session", name=f"{name}_process")
    def running() -> Iterator[StandIn]:
        with StandIn(name, *options) as stand_in:
            stand_in.sensor = sensor  # how errors call it
            yield stand_in

    return running


def _whole(name: str) -> Any:
    """Return a test's fixture: that stand-in with nothing broken, before and after."""

    @pytest.fixture(name=name)
    def whole(request: pytest.FixtureRequest) -> Iterator[StandIn]:
        stand_in = request.getfixturevalue(f"{name}_process")
        stand_in.inject("none")
        yield stand_in
        stand_in.inject("none")

    return whole


slcan_process = _running("slcan", "uskin", f"rate_hz={RATE_HZ}")
mjpeg_process = _running(
    "mjpeg", "tactip on the right finger", "sensor=tactip", "rate_hz=30", "rest_s=2", "press_s=1"
)
xela_process = _running("xela", "uskin", f"rate_hz={RATE_HZ}")
slcan, mjpeg, xela = _whole("slcan"), _whole("mjpeg"), _whole("xela")
