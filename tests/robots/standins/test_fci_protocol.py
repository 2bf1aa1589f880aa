"""Sizes and round trips of the FCI codecs, and that garbage is refused by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.standins.fci import protocol as p

REQUESTS = {  # payload sizes of libfranka-common's structures
    "connect": (p.ConnectRequest(10, 4000), 4),
    "move": (p.MoveRequest(p.Controller.EXTERNAL, p.Generator.NONE), 113),
    "collision": (p.CollisionBehavior(*[np.full(n, 9.0) for n in (7, 7, 7, 7, 6, 6, 6, 6)]), 416),
    "load": (p.Load(0.5, np.ones(3), np.arange(9.0)), 104),
    "grasp": (p.GraspRequest(0.03, 0.005, 0.006, 0.05, 20.0), 40),
    "hand move": (p.HandMoveRequest(0.03, 0.05), 16),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_requests_have_the_published_size_and_come_back(name: str) -> None:
    request, size = REQUESTS[name]
    payload = request.encode()
    assert len(payload) == size
    again = type(request).decode(payload)
    for key, value in vars(request).items():
        np.testing.assert_array_equal(getattr(again, key), value)


def test_state_and_command_have_the_published_size_and_come_back() -> None:
    floats = np.arange(p.STATE_FLOAT_COUNT, dtype=np.float32)
    state = p.RobotState(7, floats, 5, 2, frozenset({7, 25}), frozenset({6}), p.RobotMode.REFLEX, 0.5)
    datagram = state.encode()
    assert len(datagram) == 1377
    again = p.RobotState.decode(datagram)
    np.testing.assert_array_equal(again.floats, floats)
    assert (again.errors, again.reflex_reason, again.mode) == (state.errors, state.reflex_reason, state.mode)
    assert (again.message_id, again.generator, again.controller, again.success_rate) == (7, 5, 2, 0.5)
    command = p.RobotCommand(9, q_c=np.arange(7.0), tau_J_d=-np.arange(7.0), torque_finished=True)
    assert len(command.encode()) == 371
    back = p.RobotCommand.decode(command.encode())
    assert back.message_id == 9 and back.finished and not back.motion_finished
    np.testing.assert_array_equal(back.tau_J_d, command.tau_J_d)
    np.testing.assert_array_equal(back.q_c, command.q_c)


def test_fields_of_a_state_lie_where_the_published_order_puts_them() -> None:
    assert p.STATE_SLICES["O_T_EE"] == slice(0, 16)
    assert p.STATE_SLICES["q"].start == 96 + 1 + 9 + 3 + 1 + 9 + 3 + 2 + 2 + 7 * 3
    assert p.STATE_SLICES["accelerometer_bottom"].stop == 320


def test_hand_state_is_23_bytes() -> None:
    state = p.HandState(3, 0.02, 0.08, True, 31)
    assert len(state.encode()) == 23 and p.HandState.decode(state.encode()) == state


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
    p.ConnectRequest.decode,
    p.MoveRequest.decode,
    p.CollisionBehavior.decode,
    p.Load.decode,
    p.GraspRequest.decode,
    p.HandMoveRequest.decode,
    p.RobotState.decode,
    p.RobotCommand.decode,
    p.HandState.decode,
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
        p.RobotCommand.decode(p.RobotCommand(1, tau_J_d=np.full(7, np.nan)).encode())
    with pytest.raises(p.ProtocolError, match="finite"):
        p.HandMoveRequest.decode(p.HandMoveRequest(np.inf, 0.1).encode())
    with pytest.raises(p.ProtocolError, match="≤ 2 and ≤ 4"):
        p.MoveRequest.decode(p.MoveRequest(7, 9).encode())  # type: ignore[arg-type]
