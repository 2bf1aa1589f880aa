"""uSkin over SLCAN against the stand-in: exact data, every fault ten times, the full rate."""

import itertools
import os
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from benchmarks.recorder.overhead import measure_rate
from uniforce_robots.sensors import faults
from uniforce_robots.sensors.uskin_slcan import MAX_TAIL_BYTES, SlcanScans, SlcanUSkin
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_robots.standins.slcan import scan_lines
from uniforce_vtla.errors import ContractError

RATE_HZ = 100.0  # of tests/robots/conftest.py
TIMES = 10


@pytest.fixture
def source(slcan):
    return SlcanUSkin(slcan.address)


def test_scans_are_those_of_the_contact_simulator_in_order(reader):
    truth = [scan.tobytes() for scan in taxel_cycle(Scene(), RATE_HZ)]
    reader.wait_newer(50, 30_000)
    stamps_ns, scans = zip(*reader.since(-1), strict=True)
    steps = np.array([truth.index(scan.tobytes()) for scan in scans])
    assert scans[0].shape == (16, 3) and scans[0].dtype == np.uint16
    assert np.all(np.diff(steps) % len(truth) == 1)  # none lost, none twice
    assert np.all(np.diff(stamps_ns) >= 0)


DEAD = dict.fromkeys(("stall", "missing", "duplicate"), faults.StaleSensorError)
DEAD |= {"freeze": faults.FrozenSensorError, "unplug": faults.LostSensorError}


@pytest.mark.parametrize("fault, kind", DEAD.items())
def test_a_dead_patch_is_a_typed_error_and_comes_back(
    slcan, reader, fails_and_recovers, fault, kind
):
    fails_and_recovers(slcan, fault, kind, reader.newest, reader.wait_newer)
    if fault in ("missing", "duplicate"):
        assert reader.counts.lost > 0
    assert reader.reconnects >= (TIMES if fault == "unplug" else 0)


@pytest.mark.parametrize("fault", ["bel", "garbage", "split"])
def test_a_noisy_line_costs_no_scan(slcan, reader, costs_no_scan, fault):
    costs_no_scan(slcan, fault, reader)
    assert (reader.counts.bad > 0) == (fault == "garbage")


@pytest.mark.parametrize("fault, says", [("refuse", "refused"), ("mute", "no answer")])
def test_an_adapter_that_does_not_answer(slcan, source, fault, says):
    slcan.inject(fault)
    for _ in range(TIMES if fault == "refuse" else 2):
        with pytest.raises(faults.ProtocolError, match=says):
            source.open()


def test_no_port_and_a_port_that_is_none(tmp_path):
    with pytest.raises(faults.LostSensorError, match="xela_server"):
        SlcanUSkin(str(tmp_path / "absent")).open()
    (tmp_path / "file").touch()
    with pytest.raises(faults.LostSensorError):
        SlcanUSkin(str(tmp_path / "file")).open()


def test_a_reader_that_cannot_keep_up_says_so(slcan, monkeypatch):
    """Scans that waited in the kernel would carry stamps that make them look new."""
    # whatever comes is a full read
    monkeypatch.setattr("uniforce_robots.sensors.uskin_slcan.FULL_BYTES", 1)
    source = SlcanUSkin(slcan.address)
    source.max_behind_s = 0.05
    source.open()
    with pytest.raises(faults.StaleSensorError, match="keeps up"):
        for _ in range(10_000):
            source.read()
    source.close()


def test_a_held_port_is_refused(slcan, reader):
    with pytest.raises(faults.LostSensorError, match="lock"):
        SlcanUSkin(slcan.address).open()
    assert reader.newest(1e4).raw.shape == (16, 3)


class _Adapter:
    """A port on which the first scans come in one piece with the last acknowledgement."""

    def __init__(self, *_, **__):
        self._out = b""

    @property
    def in_waiting(self):
        return len(self._out)

    def reset_input_buffer(self): ...

    def close(self): ...

    def write(self, line):
        self._out += b"\r" + STREAM[:HALF_A_LINE] if line == b"O\r" else b"\r"

    def read(self, _):
        chunk = self._out
        self._out = b""
        return chunk


def test_scans_that_come_with_the_acknowledgement_are_kept(monkeypatch):
    monkeypatch.setattr("serial.Serial", _Adapter)
    source = SlcanUSkin("anywhere", controller=4)
    source.open()
    source._serial._out = STREAM[HALF_A_LINE:]
    assert np.array_equal([scan for _, scan in source.read()], CYCLE)
    assert not source.read()
    source.close()


def test_500_scans_per_second_and_none_lost():
    """The seconds to run can be set: ``UNIFORCE_RATE_SECONDS=60``."""
    seen = measure_rate(float(os.environ.get("UNIFORCE_RATE_SECONDS", "3")))
    warnings.warn(str(seen), stacklevel=1)  # shown in the summary: worth reading
    assert seen["lost"] == seen["bad"] == 0
    assert seen["samples"] == seen["sent"]
    assert seen["rate_hz"] == pytest.approx(500, rel=0.02)
    assert seen["age_p50_ms"] <= 2.0


# -- the text below
# --------------------------------------------------------------------------------------

CYCLE = np.random.default_rng(0).integers(0, 65_536, (6, 16, 3)).astype(np.uint16)
LINES = scan_lines(CYCLE, controller=4)
STREAM = b"".join(b"".join(lines) for lines in LINES)
HALF_A_LINE = len(STREAM) * 5 // 12 + 9


@pytest.fixture
def scans():
    return SlcanScans(4)


def test_a_line_of_a_real_patch(scans):
    first = b"t0048937E317E1593120F\r"  # candump 004 [8] 93 7E 31 7E 15 93 12 0F
    rest = b"".join(LINES[0][1:])
    (scan,) = scans.feed(first + rest)
    assert scan.dtype == np.uint16 and scan[0].tolist() == [0x7E31, 0x7E15, 0x9312]
    assert scan[1:].tolist() == CYCLE[0][1:].tolist()


@examples(40)
@given(st.lists(st.integers(0, len(STREAM)), max_size=30))
def test_how_the_stream_is_cut_makes_no_difference(cuts):
    scans = SlcanScans(4)
    edges = [0, *sorted(cuts), len(STREAM)]
    got = [scan for a, b in itertools.pairwise(edges) for scan in scans.feed(STREAM[a:b])]
    assert np.array_equal(got, CYCLE)
    assert (scans.counts.samples, scans.counts.lost, scans.counts.bad) == (6, 0, 0)


@examples(60)
@given(
    st.lists(st.tuples(st.integers(0, 95), st.sampled_from(["drop", "twice", "noise"])), max_size=6)
)
def test_whatever_breaks_taxels_of_two_scans_never_mix(broken):
    lines = [line for scan in LINES for line in scan]
    for at, fault in sorted(broken, reverse=True):
        line = lines[at : at + 1]  # empty where the last one was dropped before
        lines[at : at + 1] = {"drop": [], "twice": line * 2, "noise": [b"\x00xq\r", *line]}[fault]
    got = SlcanScans(4).feed(b"".join(lines))
    truth = {scan.tobytes() for scan in CYCLE}
    assert all(scan.tobytes() in truth for scan in got)


@pytest.mark.parametrize(
    "broken, lost",
    [
        (LINES[0][:7] + LINES[0][8:], 1),  # one missing
        ([*LINES[0][:4], *LINES[0][3:]], 1),  # one doubled
        (LINES[0][9:], 0),  # joined in the middle
    ],
)
def test_broken_scans_are_counted_and_whole_ones_delivered(scans, broken, lost):
    assert np.array_equal(scans.feed(b"".join(broken + LINES[1])), CYCLE[1:2])
    assert scans.counts.lost == lost


def test_replies_bells_and_other_nodes_do_no_harm(scans):
    extra = (
        b"\r\x07z\rV1013\rF00\rt7FF3010203\rt7208" + b"0" * 16 + b"\rT0000000081122334455667788\r"
    )
    assert len(scans.feed(extra + b"".join(LINES[0]))) == 1
    assert scans.counts.bad == 0


def test_adapter_time_stamps_are_allowed(scans):
    stamped = b"".join(line[:-1] + b"EA5F\r" for line in LINES[0])
    assert np.array_equal(scans.feed(stamped), CYCLE[:1])


@pytest.mark.parametrize(
    "line", [b"t00489", b"t0048937E317E1593120G", b"t0048 37E317E1593120F", b"hello"]
)
def test_nonsense_is_counted_as_bad(scans, line):
    assert not scans.feed(line + b"\r") and scans.counts.bad == 1


def test_a_stream_without_line_ends_stays_bounded(scans):
    for _ in range(1000):
        scans.feed(b"a" * 1000)
    assert len(scans._tail) <= MAX_TAIL_BYTES and scans.counts.bad == 1000


def test_a_controller_is_one_hex_digit():
    with pytest.raises(ContractError, match="controller"):
        SlcanScans(16)
