"""Dynamixel 2.0: the e-manual's own packets, and any bytes whatever."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.standins.gello import checksum, status
from uniforce_robots.teleop.dynamixel import Status, StatusReader, crc16, packet, sync_read


@pytest.mark.parametrize(
    ("ours", "manual"),
    [
        (packet(1, 0x01), "FF FF FD 00 01 03 00 01 19 4E"),  # ping
        (packet(1, 0x02, bytes([0x84, 0, 4, 0])), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),  # read
        (sync_read((1, 2)), "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),  # sync read
    ],
)
def test_questions_are_those_of_the_manual(ours: bytes, manual: str) -> None:
    assert ours == bytes.fromhex(manual)


def test_an_answer_of_the_manual_is_understood() -> None:
    answer = bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
    assert StatusReader().feed(answer) == [Status(1, 0, bytes([0xA6, 0, 0, 0]))]


@given(st.binary(max_size=64))
def test_both_checksums_agree(data: bytes) -> None:
    assert crc16(data) == checksum(data)


@examples(200)
@given(
    st.lists(st.tuples(st.integers(1, 252), st.integers(0, 255), st.binary(max_size=20)), max_size=6),
    st.lists(st.integers(1, 9), min_size=1, max_size=40),
    st.binary(max_size=12).filter(lambda noise: b"\xff" not in noise),
)
def test_answers_survive_any_splitting_and_noise_between(answers: list, sizes: list, noise: bytes) -> None:
    stream = b"".join(noise + status(motor, body, error) for motor, error, body in answers)
    reader, got, at = StatusReader(), [], 0
    for size in sizes * (len(stream) // sum(sizes) + 1):
        got += reader.feed(stream[at : at + size])
        at += size
    assert got == [Status(motor, error, body) for motor, error, body in answers]


@examples(300)
@given(st.lists(st.binary(max_size=80), max_size=10))
def test_any_bytes_are_survived_in_bounded_memory(chunks: list) -> None:
    reader = StatusReader()
    for chunk in chunks:
        for found in reader.feed(chunk):
            assert 0 <= found.device_id <= 255
        assert len(reader._buffer) <= 600


@given(st.integers(1, 8), st.integers(-(2**31), 2**31 - 1), st.data())
def test_one_flipped_bit_is_never_taken_for_an_answer(motor: int, value: int, data: st.DataObject) -> None:
    whole = bytearray(status(motor, struct.pack("<i", value)))
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    whole[bit // 8] ^= 1 << bit % 8
    assert StatusReader().feed(bytes(whole)) == []


def test_a_good_answer_behind_a_broken_claim_is_found() -> None:
    broken = b"\xff\xff\xfd\x00\x01\x20\x00\x55"  # claims 32 bytes that never come
    good = status(2, struct.pack("<i", 5))
    reader = StatusReader()
    got = reader.feed(broken + good + bytes(np.zeros(40, np.uint8)))
    assert got == [Status(2, 0, struct.pack("<i", 5))] and reader.bad == 1
