"""uSkin over SLCAN against the stand-in on a pseudo-terminal: exact data, every fault ten times, the full rate."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recorder.uskin_rate import measure_rate
from uniforce_robots.sensors.faults import FrozenSensorError, LostSensorError, ProtocolError, StaleSensorError
from uniforce_robots.sensors.reader import ReaderLimits, SampleReader
from uniforce_robots.sensors.uskin_slcan import SlcanUSkin
from uniforce_robots.standins.process import StandIn
from uniforce_robots.standins.scene import Scene, taxel_cycle

RATE_HZ = 100.0  # of the shared stand-in
MAX_AGE_MS = 150.0
TIMES = 10


@pytest.fixture
def source(slcan: StandIn) -> SlcanUSkin:
    return SlcanUSkin(slcan.address)


@pytest.fixture
def reader(source: SlcanUSkin) -> Iterator[SampleReader]:
    reader = SampleReader(source, ReaderLimits(frozen_after=20, backoff_s=0.02, backoff_max_s=0.1))
    reader.start()
    reader.wait_newer(-1, 30_000)
    yield reader
    reader.stop()


def test_scans_are_those_of_the_contact_simulator_in_order(reader: SampleReader):
    truth = [scan.tobytes() for scan in taxel_cycle(Scene(), RATE_HZ)]
    reader.wait_newer(50, 30_000)
    scans = reader.since(-1)
    steps = np.array([truth.index(scan.tobytes()) for scan in scans.data])
    assert scans.data.shape[1:] == (16, 3) and scans.data.dtype == np.uint16
    assert np.all(np.diff(steps) % len(truth) == 1)  # none lost, none twice
    assert np.all(np.diff(scans.stamps_ns) >= 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ("stall", StaleSensorError),
        ("missing", StaleSensorError),
        ("duplicate", StaleSensorError),
        ("freeze", FrozenSensorError),
        ("unplug", LostSensorError),
    ],
)
def test_a_dead_patch_is_a_typed_error_and_comes_back(
    slcan: StandIn, reader: SampleReader, outcome: Callable, recovers: Callable, fault: str, kind: type
):
    for _ in range(TIMES):
        slcan.inject(fault)
        error = outcome(lambda: reader.newest(MAX_AGE_MS), kind)
        assert "uskin" in str(error)
        slcan.inject("none")
        recovers(lambda: reader.newest(1e4))
        reader.wait_newer(reader.newest(1e4).index, 30_000)
    if fault in ("missing", "duplicate"):
        assert reader.counts.lost > 0
    assert reader.reconnects >= (TIMES if fault == "unplug" else 0)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["bel", "garbage", "split"])
def test_a_noisy_line_costs_no_scan(slcan: StandIn, reader: SampleReader, source: SlcanUSkin, fault: str):
    truth = {scan.tobytes() for scan in taxel_cycle(Scene(), RATE_HZ)}
    for _ in range(TIMES):
        slcan.inject(fault)
        before = reader.newest(1e4).index
        after = reader.wait_newer(before + 5, 30_000)
        assert all(scan.tobytes() in truth for scan in reader.since(before).data)
        assert after.index > before + 5
        slcan.inject("none")
    assert source.scans.bells > 0 if fault == "bel" else (reader.counts.bad > 0) == (fault == "garbage")


@pytest.mark.parametrize(("fault", "says"), [("refuse", "refused"), ("mute", "no answer")])
def test_an_adapter_that_does_not_answer(slcan: StandIn, source: SlcanUSkin, fault: str, says: str):
    slcan.inject(fault)
    for _ in range(TIMES if fault == "refuse" else 2):
        with pytest.raises(ProtocolError, match=says):
            source.open()


def test_no_port_and_a_port_that_is_none(tmp_path: Path):
    with pytest.raises(LostSensorError, match="xela_server"):
        SlcanUSkin(str(tmp_path / "absent")).open()
    (tmp_path / "file").touch()
    with pytest.raises(LostSensorError):
        SlcanUSkin(str(tmp_path / "file")).open()


def test_a_reader_that_cannot_keep_up_says_so(slcan: StandIn, monkeypatch: pytest.MonkeyPatch):
    """Scans that waited in the kernel would carry stamps that make them look new."""
    monkeypatch.setattr(
        "uniforce_robots.sensors.uskin_slcan.FULL_BYTES", 1
    )  # whatever comes counts as a full read
    source = SlcanUSkin(slcan.address, max_behind_s=0.05)
    source.open()
    with pytest.raises(StaleSensorError, match="keeps up"):
        for _ in range(10_000):
            source.read()
    source.close()


def test_a_held_port_is_refused(slcan: StandIn, reader: SampleReader):
    with pytest.raises(LostSensorError, match="lock"):
        SlcanUSkin(slcan.address).open()
    assert reader.newest(1e4).data.shape == (16, 3)


@pytest.mark.slow
def test_500_scans_per_second_and_none_lost():
    """The seconds to run can be set: ``UNIFORCE_RATE_SECONDS=60``."""
    seen = measure_rate(float(os.environ.get("UNIFORCE_RATE_SECONDS", "5")))
    warnings.warn(str(seen), stacklevel=1)  # shown in the summary: worth reading
    assert seen["lost"] == seen["bad"] == 0
    assert seen["samples"] == seen["sent"]
    assert seen["rate_hz"] == pytest.approx(500, rel=0.02)
    assert seen["age_p50_ms"] <= 2.0
