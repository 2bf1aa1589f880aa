"""The WebSocket client: frames cut anywhere, what the RFC forbids, and an independent server."""

from __future__ import annotations

import itertools
import socket
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from uniforce_robots.sensors.backlog import Backlog
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError, StaleSensorError
from uniforce_robots.sensors.websocket import (
    MAX_MESSAGE_BYTES,
    PING,
    TEXT,
    FrameReader,
    WebSocket,
)
from uniforce_robots.standins.xela import frame

TEXTS = [b"", b"short", b"x" * 126, b"y" * 70_000]


@examples(60)
@given(cuts=st.lists(st.integers(0, 70_300), max_size=12), pieces=st.integers(1, 4))
def test_how_frames_are_cut_makes_no_difference(cuts: list[int], pieces: int):
    data = b"".join(_fragmented(text, pieces) for text in TEXTS)
    reader, edges = FrameReader("server"), [0, *sorted(min(c, len(data)) for c in cuts), len(data)]
    got = [m for a, b in itertools.pairwise(edges) for m in reader.feed(data[a:b])]
    assert [m.payload for m in got if m.opcode == TEXT] == TEXTS
    assert sum(m.opcode == PING for m in got) == (pieces - 1) * len(TEXTS)


def _fragmented(text: bytes, pieces: int) -> bytes:
    size = -(-len(text) // pieces)
    parts = [text[i * size : (i + 1) * size] for i in range(pieces)]
    framed = [frame(0 if i else TEXT, part, i == pieces - 1) for i, part in enumerate(parts)]
    return frame(PING, b"!").join(framed)


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
    ],
)
def test_what_the_rfc_forbids_is_a_typed_error(data: bytes):
    with pytest.raises(ProtocolError):
        FrameReader("server").feed(data)


def test_fragments_without_end_stay_bounded():
    reader = FrameReader("server")
    reader.feed(frame(TEXT, b"a", False))
    for _ in range(5000):
        reader.feed(frame(0, b"", False))
    assert len(reader._parts) == 1
    with pytest.raises(ProtocolError, match="at most"):
        for _ in range(20):
            reader.feed(frame(0, b"x" * 60_000, False))


@pytest.fixture
def library_server() -> Iterator[int]:
    """Serve greetings, a ping and a farewell with the ``websockets`` package."""
    server_module = pytest.importorskip("websockets.sync.server")

    def serve(connection: object) -> None:
        connection.send("Welcome")
        connection.send(["in ", "three ", "parts"])
        connection.ping().wait(10)
        connection.send("pong heard")  # often in one packet with the farewell that follows

    with server_module.serve(serve, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.socket.getsockname()[1]
        server.shutdown()


def test_an_independent_server_is_understood(library_server: int):
    client, texts = WebSocket("127.0.0.1", library_server, "server"), []
    with pytest.raises(LostSensorError, match="farewell"):
        for _ in range(200):
            texts += client.receive(1.0)
    client.close()
    assert texts == ["Welcome", "in three parts", "pong heard"]


@pytest.mark.parametrize("answer", [b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 9000, b"", b"HTTP/1.1 101 S\r\n\r\n"])
def test_what_is_no_websocket_server_is_a_typed_error(answer: bytes):
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        connection.recv(4096)
        connection.sendall(answer)
        connection.close()

    threading.Thread(target=serve, daemon=True).start()
    with pytest.raises((ProtocolError, LostSensorError)):
        WebSocket("127.0.0.1", listener.getsockname()[1], "server")
    listener.close()


def test_a_backlog_is_an_error_only_while_it_lasts(monkeypatch: pytest.MonkeyPatch):
    clock = [0.0]
    monkeypatch.setattr("uniforce_robots.sensors.backlog.time.monotonic", lambda: clock[0])
    backlog = Backlog("server", 100, 0.25)
    for size in (100, 200, 99, 100):  # one short read: it caught up
        assert backlog.more_waits(size) == (size >= 100)
        clock[0] += 0.2
    clock[0] += 0.1
    with pytest.raises(StaleSensorError, match="keeps up"):
        backlog.more_waits(100)


def test_nobody_there():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(LostSensorError, match="running"):
        WebSocket("127.0.0.1", port, "server")
