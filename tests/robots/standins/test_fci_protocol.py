"""Garbage in place of FCI messages is refused by name; the real client tests good ones."""

import struct
from functools import partial

import numpy as np
import pytest
from fci_client import decode_hand_state, decode_state, encode_command, hand_request
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.standins.fci import protocol as p


def test_a_message_may_arrive_in_pieces():
    whole = p.ARM_HEADER.encode(p.Message(1, 5, b"abc"))
    for cut in range(len(whole)):
        message, rest = p.ARM_HEADER.decode(whole[:cut])
        assert message is None and rest == whole[:cut]
    assert p.ARM_HEADER.decode(whole + b"x") == (p.Message(1, 5, b"abc"), b"x")


@pytest.mark.parametrize("size", [0, 11, 2**32 - 1])
def test_an_impossible_size_is_refused(size):
    with pytest.raises(p.ProtocolError, match="message size"):
        p.ARM_HEADER.decode(p.ARM_HEADER.layout.pack(1, 1, size))


DECODERS = [
    partial(p.unpack, p.MOVE, what="Move"),
    partial(p.decode_hand, p.Grasp),
    partial(p.decode_hand, p.HandMove),
    partial(
        p.numbers,
        struct.Struct(p.SETTERS[p.ArmCommand.SET_COLLISION_BEHAVIOR]),
        what="SetCollisionBehavior",
    ),
    partial(p.unpack, p.CONNECT, what="Connect"),
    decode_state,
    p.RobotCommand.decode,
    decode_hand_state,
    p.ARM_HEADER.decode,
    p.HAND_HEADER.decode,
]
SIZES = [4, 10, 12, 16, 23, 40, 104, 113, 371, 416, 1377]


@pytest.mark.parametrize("decode", DECODERS)
@examples(60)
@given(data=st.data())
def test_garbage_is_decoded_or_refused_by_name(decode, data):
    size = data.draw(st.sampled_from(SIZES) | st.integers(0, 1500))
    garbage = data.draw(st.randoms(use_true_random=False)).randbytes(size)
    try:
        decode(garbage)
    except p.ProtocolError as error:
        assert "expected" in str(error)


def test_numbers_that_are_none_are_refused():
    with pytest.raises(p.ProtocolError, match="finite"):
        p.RobotCommand.decode(encode_command(p.RobotCommand(1, tau_J_d=np.full(7, np.nan))))
    with pytest.raises(p.ProtocolError, match="finite"):
        p.decode_hand(p.HandMove, hand_request(np.inf, 0.1))
