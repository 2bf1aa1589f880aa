"""Sizes and round trips of the FCI codecs, and that garbage is refused by name."""

import struct
from functools import partial

import numpy as np
import pytest
from fci_client import decode_hand_state, decode_state, encode_command, hand_request, move
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.standins.fci import protocol as p

# payload sizes of libfranka-common's structures
GUIDING_MODE = struct.Struct(p.SETTERS[p.ArmCommand.SET_GUIDING_MODE])
SIZES_OF = {p.CONNECT: 4, p.MOVE: 113, GUIDING_MODE: 7}


def test_requests_have_the_published_size_and_are_read() -> None:
    assert {layout: layout.size for layout in SIZES_OF} == SIZES_OF
    assert p.unpack(p.MOVE, move(), "Move")[:2] == p.TORQUE_CONTROL
    assert p.decode_hand(p.HandMove, hand_request(0.03, 0.05)) == p.HandMove(0.03, 0.05)
    assert p.decode_hand(p.Grasp, hand_request(0.03, 0.005, 0.006, 0.05, 20.0)).outer_m == 0.006


def test_state_and_command_have_the_published_size_and_come_back() -> None:
    floats = np.arange(p.STATE_FLOAT_COUNT, dtype=np.float32)
    state = p.RobotState(7, floats, 5, 2, frozenset({7, 25}), frozenset({6}), p.RobotMode.REFLEX, 0.5)
    datagram = state.encode()
    assert len(datagram) == 1377
    again = decode_state(datagram)
    np.testing.assert_array_equal(again.floats, floats)
    assert vars(again) | {"floats": 0} == vars(state) | {"floats": 0}
    command = p.RobotCommand(9, tau_J_d=-np.arange(7.0), finished=True)
    assert len(encode_command(command)) == 371
    back = p.RobotCommand.decode(encode_command(command))
    assert back.message_id == 9 and back.finished
    np.testing.assert_array_equal(back.tau_J_d, command.tau_J_d)
    hand = p.HandState(3, 0.02, 0.08, True, 31)
    assert len(hand.encode()) == 23 and decode_hand_state(hand.encode()) == hand


def test_fields_of_a_state_lie_where_the_published_order_puts_them() -> None:
    assert p.STATE_SLICES["O_T_EE"] == slice(0, 16)
    assert p.STATE_SLICES["q"].start == 96 + 1 + 9 + 3 + 1 + 9 + 3 + 2 + 2 + 7 * 3
    assert p.STATE_SLICES["accelerometer_bottom"].stop == 320


def test_a_message_may_arrive_in_pieces() -> None:
    whole = p.ARM_HEADER.encode(p.Message(1, 5, b"abc"))
    for cut in range(len(whole)):
        message, rest = p.ARM_HEADER.decode(whole[:cut])
        assert message is None and rest == whole[:cut]
    assert p.ARM_HEADER.decode(whole + b"x") == (p.Message(1, 5, b"abc"), b"x")


@pytest.mark.parametrize("size", [0, 11, 2**32 - 1])
def test_an_impossible_size_is_refused(size: int) -> None:
    with pytest.raises(p.ProtocolError, match="message size"):
        p.ARM_HEADER.decode(p.ARM_HEADER.layout.pack(1, 1, size))


DECODERS = [
    partial(p.unpack, p.MOVE, what="Move"),
    partial(p.decode_hand, p.Grasp),
    partial(p.decode_hand, p.HandMove),
    partial(p.numbers, struct.Struct(p.SETTERS[p.ArmCommand.SET_COLLISION_BEHAVIOR]), what="SetCollisionBehavior"),
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
def test_garbage_is_decoded_or_refused_by_name(decode, data) -> None:
    size = data.draw(st.sampled_from(SIZES) | st.integers(0, 1500))
    garbage = data.draw(st.randoms(use_true_random=False)).randbytes(size)
    try:
        decode(garbage)
    except p.ProtocolError as error:
        assert "expected" in str(error)


def test_numbers_that_are_none_are_refused() -> None:
    with pytest.raises(p.ProtocolError, match="finite"):
        p.RobotCommand.decode(encode_command(p.RobotCommand(1, tau_J_d=np.full(7, np.nan))))
    with pytest.raises(p.ProtocolError, match="finite"):
        p.decode_hand(p.HandMove, hand_request(np.inf, 0.1))
