"""Parsers of bytes from a device: each with a stream that is right, to be injured."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

import numpy as np
from mutations import chunks
from standins import spacemouse
from standins.xela import frame, greeting, message
from websockets.frames import Opcode

from uniforce_robots.sensors.mjpeg import (
    MAX_HEADER_BYTES,
    MAX_JPEG_BYTES,
    MultipartJpeg,
    decode_bgr,
)
from uniforce_robots.sensors.uskin_server import MAX_MESSAGE_BYTES, XelaMessages, read_message
from uniforce_robots.sensors.uskin_slcan import MAX_TAIL_BYTES, SlcanScans
from uniforce_robots.standins.mjpeg import encode, part
from uniforce_robots.standins.slcan import scan_lines
from uniforce_robots.teleop.spacemouse import LARGEST_COUNT, SpaceMouseSource
from uniforce_vtla.errors import SensorError, TeleoperatorError


@dataclass(frozen=True)
class ByteTarget:
    """A parser, bytes it accepts, and the errors it may raise over others."""

    feed: Callable[[np.random.Generator, bytes], None]
    seed: bytes
    typed: tuple[type[Exception], ...] = (SensorError,)
    refuses: bool = True  # False for a reader that resynchronises instead


def feed_slcan(rng, data):
    reader = SlcanScans()
    for chunk in chunks(rng, data):
        for scan in reader.feed(chunk):
            assert scan.shape == (16, 3) and scan.dtype == np.uint16
        assert len(reader._tail) <= MAX_TAIL_BYTES


def feed_websocket(rng, data):
    client = XelaMessages("127.0.0.1", 1, "fuzz")
    client.feed(greeting(b"".join(client.protocol.data_to_send())))
    for chunk in filter(None, chunks(rng, data)):
        for text in client.feed(chunk):
            read_message(text, "1", "fuzz")
        waiting = len(client.protocol.reader.buffer) + sum(map(len, client._parts))
        assert waiting <= MAX_MESSAGE_BYTES + len(data)


def feed_json(rng, data):
    _, counts = read_message(data.decode(errors="replace"), "1", "fuzz")
    assert counts is None or counts.shape == (16, 3)


def feed_mjpeg(rng, data):
    reader = MultipartJpeg("fuzz")
    for chunk in chunks(rng, data):
        for got in reader.feed(chunk):
            assert len(got) <= MAX_JPEG_BYTES
            decode_bgr(got)
        assert len(reader._buffer) <= MAX_JPEG_BYTES + MAX_HEADER_BYTES + len(data)


def feed_spacemouse(rng, data):
    reader = SpaceMouseSource()
    for report in chunks(rng, data):
        reader.feed(report)
        assert np.abs(reader.state).max() <= LARGEST_COUNT


SCANS = np.random.default_rng(0).integers(0, 65_536, (2, 16, 3)).astype(np.uint16)
JPEG = encode(np.random.default_rng(1).integers(0, 255, (16, 24, 3), dtype=np.uint8))
HTTP = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=uniforceframe\r\n\r\n"
JSON = message(7, SCANS[0], "null").encode()
BYTE_TARGETS = {
    "slcan": ByteTarget(
        feed_slcan,
        b"\r\rV1013\r" + b"".join(chain.from_iterable(scan_lines(SCANS, 0))),
        refuses=False,
    ),
    "websocket": ByteTarget(
        feed_websocket,
        frame(Opcode.TEXT, b'{"message": "Welcome"}')
        + frame(Opcode.PING, b"ping")
        + frame(Opcode.TEXT, JSON[:300], False)
        + frame(Opcode.CONT, JSON[300:]),
    ),
    "json": ByteTarget(feed_json, JSON),
    "mjpeg": ByteTarget(feed_mjpeg, HTTP + 3 * part(JPEG)),
    "spacemouse": ByteTarget(
        feed_spacemouse,
        b"".join(spacemouse.reports((1, -350, 0, 9, 350, -2), 3, "three")),
        (TeleoperatorError,),
        refuses=False,
    ),
}
