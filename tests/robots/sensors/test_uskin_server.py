"""uSkin through xela_server: every form its messages take, every fault ten times."""

import itertools
import json
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scripted import one_request
from standins.xela import fragmented, frame, greeting
from websockets.frames import Opcode

from uniforce_robots.sensors import faults
from uniforce_robots.sensors.uskin_server import (
    MAX_MESSAGE_BYTES,
    ServerUSkin,
    XelaMessages,
    read_message,
)
from uniforce_vtla.errors import ContractError, SensorError

TIMES = 10


@pytest.fixture
def source(xela):
    return ServerUSkin(xela.address)


DEAD = dict.fromkeys(("welcome", "stall"), faults.StaleSensorError)
DEAD |= {"freeze": faults.FrozenSensorError, "stop": faults.LostSensorError}
WRONG = {"sim": faults.SimulatedSensorError, "badframe": faults.ProtocolError}
WRONG |= dict.fromkeys(("short", "absent"), faults.WrongSensorError)


@pytest.mark.parametrize("fault, kind", (DEAD | WRONG).items())
def test_a_dead_or_wrong_server_is_a_typed_error_and_comes_back(
    xela, reader, fails_and_recovers, fault, kind
):
    fails_and_recovers(xela, fault, kind, reader.newest, reader.wait_newer)


def test_a_closed_connection_is_opened_again(xela, reader, recovers):
    def back(times):
        if reader.reconnects < times:
            raise SensorError("not yet")
        reader.newest(1e4)

    for i in range(TIMES):
        xela.inject("close")
        recovers(lambda i=i: back(i + 1))
        xela.inject("none")


@pytest.mark.parametrize(
    "fault", ["none", "list", "integers", "null", "fragments", "ping", "garbage"]
)
def test_every_form_of_message_is_understood(xela, reader, costs_no_scan, fault):
    costs_no_scan(xela, fault, reader)
    assert (reader.counts.bad > 0) == (fault == "garbage") and reader.reconnects == 0


def routine(data):
    return json.dumps({"type": "routine", "1": {"data": data}})


@pytest.mark.parametrize(
    "text, kind",
    [
        *(
            (text, faults.ProtocolError)
            for text in ("", "[" * 500_000, '{"a":' * 200_000, "9" * 100_000, "[1]")
        ),
        *(
            (routine(data), faults.ProtocolError)
            for data in (None, [[]] * 48, ["+1"] * 48, [True] * 48, [65_536] * 48)
        ),
        ('{"type": "routine"}', faults.WrongSensorError),
        (routine("1,2,3"), faults.WrongSensorError),
        ('{"message": "Welcome", "server": {"bustype": "SIM"}}', faults.SimulatedSensorError),
    ],
)
def test_messages_that_are_no_scan(text, kind):
    with pytest.raises(kind):
        read_message(text, "1", "uskin")


@pytest.mark.parametrize("address", ["", ":5000", "host:x", "host:0", "host:70000"])
def test_addresses_that_cannot_be(address):
    with pytest.raises(ContractError, match="host:port"):
        ServerUSkin(address)


# -- the WebSocket below
# ----------------------------------------------------------------------------------

TEXTS = ["", "short", "x" * 126, "y" * 70_000]


def open_messages():
    client = XelaMessages("127.0.0.1", 5000, "server")
    client.feed(greeting(b"".join(client.protocol.data_to_send())))
    return client


@examples(60)
@given(cuts=st.lists(st.integers(0, 70_300), max_size=12), pieces=st.integers(1, 4))
def test_how_frames_are_cut_makes_no_difference(cuts, pieces):
    data = b"".join(fragmented(text.encode(), pieces) for text in TEXTS)
    client = open_messages()
    edges = sorted({0, *(min(c, len(data)) for c in cuts), len(data)})
    assert [text for a, b in itertools.pairwise(edges) for text in client.feed(data[a:b])] == TEXTS
    pongs = b"".join(client.protocol.data_to_send()).count(bytes([0x80 | Opcode.PONG]))
    assert pongs >= (pieces - 1) * len(TEXTS)


@pytest.mark.parametrize(
    "data",
    [
        b"\xc1\x00",  # reserved bit
        b"\x81\x80\x00\x00\x00\x00",  # masked
        b"\x83\x00",  # reserved opcode
        b"\x80\x00",  # continuation of nothing
        b"\x01\x01a\x81\x01b",  # a new message inside a fragmented one
        b"\x09\x00",  # a ping in fragments
        b"\x89\x7e\x00\x80" + b"x" * 128,  # a ping beyond 125 bytes
        b"\x81\x7f" + (MAX_MESSAGE_BYTES + 1).to_bytes(8),
        b"\x81\x02\xff\xfe",  # no UTF-8
    ],
)
def test_what_the_rfc_forbids_is_a_typed_error(data):
    with pytest.raises(faults.ProtocolError):
        open_messages().feed(data)


def test_fragments_without_end_stay_bounded():
    messages = open_messages()
    messages.feed(frame(Opcode.TEXT, b"a", False))
    for _ in range(5000):
        messages.feed(frame(Opcode.CONT, b"", False))
    assert len(messages._parts) == 1
    with pytest.raises(faults.ProtocolError, match="limit"):
        for _ in range(20):
            messages.feed(frame(Opcode.CONT, b"x" * 60_000, False))


@pytest.mark.parametrize(
    "answer", [b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 9000, b"", b"HTTP/1.1 101 S\r\n\r\n"]
)
def test_what_is_no_websocket_server_is_a_typed_error(answer):
    with (
        one_request(answer) as (address, _),
        pytest.raises((faults.ProtocolError, faults.LostSensorError)),
    ):
        ServerUSkin(address).open()


def test_an_address_without_a_server():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = "{}:{}".format(*listener.getsockname())
    with pytest.raises(faults.LostSensorError, match="running"):
        ServerUSkin(address).open()
