"""Stand-ins shared by all device tests, and how much of a core this machine gives us: deadlines scale with it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(
    0, str(Path(__file__).parent)
)  # scripted_capture: importlib mode gives test folders no package

from uniforce_robots.standins.process import StandIn
from uniforce_vtla.errors import SensorError

OUTCOME_S = 0.5  # a fault must show within this on a machine that has time for us
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


def _running(name: str, *options: str) -> Any:
    """Return a session's fixture: a stand-in of its own process, started once."""

    @pytest.fixture(scope="session", name=f"{name}_process")
    def running() -> Iterator[StandIn]:
        with StandIn(name, *options) as stand_in:
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


slcan_process = _running("slcan", f"rate_hz={RATE_HZ}")
mjpeg_process = _running("mjpeg", "sensor=tactip", "rate_hz=15", "rest_s=2", "press_s=1")
xela_process = _running("xela", f"rate_hz={RATE_HZ}")
slcan, mjpeg, xela = _whole("slcan"), _whole("mjpeg"), _whole("xela")
