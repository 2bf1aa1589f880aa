"""The ring: what goes in comes out, in order, whole, with its time."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.sensors.faults import WrongSensorError
from uniforce_robots.sensors.samples import NS_PER_MS, SampleRing, Stamped, now_ns
from uniforce_vtla.errors import ContractError


def filled(count: int, capacity: int = 8) -> SampleRing:
    ring = SampleRing(capacity)
    for i in range(count):
        ring.push(Stamped(1_000_000 * (i + 1), np.array([i, -i], np.int32)))
    return ring


@examples(60)
@given(
    count=st.integers(0, 40), capacity=st.integers(2, 9), size=st.integers(1, 9), since=st.integers(-1, 45)
)
def test_the_ring_is_the_end_of_a_list(count: int, capacity: int, size: int, since: int):
    ring, model = filled(count, capacity), list(range(count))
    newest = ring.newest()
    assert (newest is None) == (count == 0) and (newest is None or newest.index == count - 1)
    later = ring.since(since)
    expected = model[since + 1 :][-capacity:]
    assert [row[0] for row in later.data.tolist()] == expected and later.count == len(expected)
    assert later.first_index == count - later.count
    if count and size <= capacity:
        window = ring.window(size)
        assert window.data[size - window.count :, 0].tolist() == model[-size:]
        assert window.data.shape == (size, 2) and not window.stamps_ns[: size - window.count].any()


def test_a_window_repeats_the_oldest_sample_instead_of_inventing_zeros():
    window = filled(3).window(5)
    assert window.count == 3 and window.data[:, 0].tolist() == [0, 0, 0, 1, 2]
    assert window.stamps_ns.tolist() == [0, 0, 1_000_000, 2_000_000, 3_000_000]


def test_what_is_returned_is_a_copy():
    ring = filled(2, 2)
    newest, window = ring.newest(), ring.window(2)
    assert newest is not None
    newest.data[:], window.data[:] = 7, 7
    assert ring.window(2).data[:, 0].tolist() == [0, 1]


def test_rate_and_age_are_measured():
    assert filled(50, 64).rate_hz() == pytest.approx(1000)
    assert filled(1).rate_hz() == 0
    ring = SampleRing(2)
    ring.push(Stamped(now_ns() - round(30 * NS_PER_MS), np.zeros(1, np.uint8)))
    newest = ring.newest()
    assert newest is not None and newest.age_ms() >= 30


@pytest.mark.parametrize("bad", [np.zeros(3, np.int32), np.zeros(2, np.int64), np.zeros((), np.int32)])
def test_another_shape_or_dtype_is_refused(bad: np.ndarray):
    with pytest.raises(WrongSensorError, match="sample"):
        filled(1).push(Stamped(0, bad))


def test_windows_and_capacities_out_of_range():
    with pytest.raises(ContractError, match="window"):
        filled(3).window(9)
    with pytest.raises(ContractError, match="none yet"):
        filled(0).window(1)


def test_waiting_ends_with_a_sample_or_in_time():
    ring = filled(2)
    assert ring.wait_newer(1, 0.01) is None
    threading.Timer(0.02, lambda: ring.push(Stamped(5, np.array([5, 5], np.int32)))).start()
    newer = ring.wait_newer(1, 30)
    assert newer is not None and newer.index == 2
