"""SLCAN text → scans: any cutting of the stream, and scans that break."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.sensors.slcan_lines import MAX_TAIL_BYTES, SlcanScans, uspa44_ids
from uniforce_robots.standins.slcan import scan_lines
from uniforce_vtla.errors import ContractError

CYCLE = np.random.default_rng(0).integers(0, 65_536, (6, 16, 3)).astype(np.uint16)
LINES = scan_lines(CYCLE, controller=4)
STREAM = b"".join(b"".join(lines) for lines in LINES)


def reader() -> SlcanScans:
    return SlcanScans(uspa44_ids(4))


def test_a_line_of_a_real_patch():
    first = b"t0048937E317E1593120F\r"  # candump 004 [8] 93 7E 31 7E 15 93 12 0F
    rest = b"".join(LINES[0][1:])
    (scan,) = reader().feed(first + rest)
    assert scan.dtype == np.uint16 and scan[0].tolist() == [0x7E31, 0x7E15, 0x9312]
    assert scan[1:].tolist() == CYCLE[0][1:].tolist()


@examples(40)
@given(st.lists(st.integers(0, len(STREAM)), max_size=30))
def test_how_the_stream_is_cut_makes_no_difference(cuts: list[int]):
    scans, edges = reader(), [0, *sorted(cuts), len(STREAM)]
    got = [scan for a, b in itertools.pairwise(edges) for scan in scans.feed(STREAM[a:b])]
    assert np.array_equal(got, CYCLE)
    assert (scans.counts.samples, scans.counts.lost, scans.counts.bad) == (6, 0, 0)


@examples(60)
@given(st.lists(st.tuples(st.integers(0, 95), st.sampled_from(["drop", "twice", "noise"])), max_size=6))
def test_whatever_breaks_taxels_of_two_scans_never_mix(faults: list[tuple[int, str]]):
    lines = [line for scan in LINES for line in scan]
    for at, fault in sorted(faults, reverse=True):
        line = lines[at : at + 1]  # empty where the last one was dropped before
        lines[at : at + 1] = {"drop": [], "twice": line * 2, "noise": [b"\x00xq\r", *line]}[fault]
    got = reader().feed(b"".join(lines))
    truth = {scan.tobytes() for scan in CYCLE}
    assert all(scan.tobytes() in truth for scan in got)


def test_broken_scans_are_counted():
    scans = reader()
    missing = b"".join(LINES[0][:7] + LINES[0][8:])
    doubled = b"".join([*LINES[1][:4], *LINES[1][3:]])
    assert scans.feed(missing + doubled + b"".join(LINES[2])) and scans.counts.lost == 2


def test_joining_in_the_middle_of_a_scan_loses_nothing_that_was_whole():
    scans = reader()
    got = scans.feed(b"".join(LINES[0][9:]) + b"".join(LINES[1]))
    assert len(got) == 1 and np.array_equal(got[0], CYCLE[1]) and scans.counts.lost == 0


def test_replies_bells_and_other_nodes_do_no_harm():
    scans = reader()
    extra = b"\r\x07z\rV1013\rF00\rt7FF3010203\rt7208" + b"0" * 16 + b"\rT0000000081122334455667788\r"
    assert len(scans.feed(extra + b"".join(LINES[0]))) == 1
    assert scans.bells == 1 and scans.counts.bad == 0 and scans.foreign == 7


def test_adapter_time_stamps_are_allowed():
    stamped = b"".join(line[:-1] + b"EA5F\r" for line in LINES[0])
    assert np.array_equal(reader().feed(stamped), CYCLE[:1])


@pytest.mark.parametrize("line", [b"t00489", b"t0048937E317E1593120G", b"t0048 37E317E1593120F", b"hello"])
def test_nonsense_is_counted_as_bad(line: bytes):
    scans = reader()
    assert not scans.feed(line + b"\r") and scans.counts.bad == 1


def test_a_stream_without_line_ends_stays_bounded():
    scans = reader()
    for _ in range(1000):
        scans.feed(b"a" * 1000)
    assert len(scans._tail) <= MAX_TAIL_BYTES and scans.counts.bad == 1000


@pytest.mark.parametrize("ids", [(1, 2), (0,) * 16, (*range(15), 0x800)])
def test_an_id_map_that_cannot_be(ids: tuple[int, ...]):
    with pytest.raises(ContractError, match="id map"):
        SlcanScans(ids)


def test_ids_of_a_patch():
    assert uspa44_ids(4)[:5] == (0x004, 0x014, 0x024, 0x034, 0x104) and uspa44_ids()[-1] == 0x330
    with pytest.raises(ContractError, match="controller"):
        uspa44_ids(16)
