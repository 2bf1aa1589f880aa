"""Mutated bytes into every parser of a device: no hang, no crash, no untyped exception, bounded memory.

``UNIFORCE_FUZZ_INPUTS`` sets how many inputs each parser gets: 1,500 in the suite, 100,000 by ``make fuzz``.
"""

from __future__ import annotations

import itertools
import json
import os
import time
from collections.abc import Callable

import numpy as np
import pytest

from lerobot_camera_uniforce.http_capture import decode_bgr
from lerobot_camera_uniforce.multipart_jpeg import MAX_HEADER_BYTES, MAX_JPEG_BYTES, MultipartJpeg
from lerobot_camera_uniforce.slcan_lines import MAX_TAIL_BYTES, SlcanScans, uspa44_ids
from lerobot_camera_uniforce.websocket import MAX_MESSAGE_BYTES, TEXT, FrameReader
from lerobot_camera_uniforce.xela_message import read_message
from lerobot_teleoperator_uniforce.dynamixel import StatusReader
from lerobot_teleoperator_uniforce.spacemouse_reports import LARGEST_COUNT, SpaceMouseReports
from uniforce_standins import spacemouse
from uniforce_standins.gello import status
from uniforce_standins.mjpeg import encode, part
from uniforce_standins.slcan import scan_lines
from uniforce_standins.xela import frame, message
from uniforce_vtla.errors import SensorError

INPUTS = int(os.environ.get("UNIFORCE_FUZZ_INPUTS", "1500"))
SLOWEST_S = 5.0  # one input of a few KB; generous, since the machine may be busy with something else
TRICKS = ("flip", "drop", "repeat", "insert", "cut", "swap", "digit")

SCANS = np.random.default_rng(0).integers(0, 65_536, (2, 16, 3)).astype(np.uint16)
JPEG = encode(np.random.default_rng(1).integers(0, 255, (16, 24, 3), dtype=np.uint8))
HTTP = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=uniforceframe\r\n\r\n"


def mutate(rng: np.random.Generator, data: bytes) -> bytes:
    """Return ``data`` after one to eight random injuries."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if not out:
            break
        at, size = int(rng.integers(len(out))), int(rng.integers(1, 24))
        trick = TRICKS[int(rng.integers(len(TRICKS)))]
        if trick == "flip":
            out[at] ^= 1 << int(rng.integers(8))
        elif trick == "drop":
            del out[at : at + size]
        elif trick == "repeat":
            out[at:at] = out[at : at + size] * int(rng.integers(1, 5))
        elif trick == "insert":
            out[at:at] = rng.bytes(size)
        elif trick == "cut":
            del out[at:]
        elif trick == "swap":
            out[at : at + size] = out[at : at + size][::-1]
        else:
            out[at] = b"0123456789ABCDEF\r\n\x07-"[int(rng.integers(20))]
    return bytes(out)


def chunks(rng: np.random.Generator, data: bytes) -> list[bytes]:
    """Return ``data`` in up to six pieces."""
    edges = [
        0,
        *sorted(int(cut) for cut in rng.integers(0, len(data) + 1, int(rng.integers(0, 6)))),
        len(data),
    ]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


def feed_slcan(rng: np.random.Generator, data: bytes) -> None:
    reader = SlcanScans(uspa44_ids())
    for chunk in chunks(rng, data):
        for scan in reader.feed(chunk):
            assert scan.shape == (16, 3) and scan.dtype == np.uint16
        assert len(reader._tail) <= MAX_TAIL_BYTES


def feed_websocket(rng: np.random.Generator, data: bytes) -> None:
    reader = FrameReader("fuzz")
    for chunk in chunks(rng, data):
        for got in reader.feed(chunk):
            if got.opcode == TEXT:
                read_message(got.payload.decode(errors="replace"), "1", "fuzz")
        assert len(reader._buffer) + reader._size <= MAX_MESSAGE_BYTES + len(data)


def feed_json(rng: np.random.Generator, data: bytes) -> None:
    scan = read_message(data.decode(errors="replace"), "1", "fuzz")
    assert scan is None or scan.counts.shape == (16, 3)


def feed_mjpeg(rng: np.random.Generator, data: bytes) -> None:
    reader = MultipartJpeg("fuzz")
    for chunk in chunks(rng, data):
        for got in reader.feed(chunk):
            assert len(got.jpeg) <= MAX_JPEG_BYTES
            decode_bgr(got.jpeg)
        assert len(reader._buffer) <= MAX_JPEG_BYTES + MAX_HEADER_BYTES + len(data)


def feed_dynamixel(rng: np.random.Generator, data: bytes) -> None:
    reader = StatusReader()
    for chunk in chunks(rng, data):
        for got in reader.feed(chunk):
            assert 0 <= got.device_id <= 255 and len(got.parameters) < 300
        assert len(reader._buffer) <= 300


def feed_spacemouse(rng: np.random.Generator, data: bytes) -> None:
    reader = SpaceMouseReports()
    for report in chunks(rng, data):
        reader.feed(report)
        assert np.abs(reader.state).max() <= LARGEST_COUNT


SLCAN = b"\r\rV1013\r" + b"".join(b"".join(lines) for lines in scan_lines(SCANS, 0))
JSON = message(7, SCANS[0], "null").encode()
WEBSOCKET = (
    frame(TEXT, b'{"message": "Welcome"}')
    + frame(0x9, b"ping")
    + frame(TEXT, JSON[:300], False)
    + frame(0, JSON[300:])
)
MJPEG = HTTP + part(JPEG, 1.5) + part(JPEG, 2.5, with_length=False) + part(JPEG, 3.5)
PARSERS: dict[str, tuple[Callable, bytes]] = {
    "slcan": (feed_slcan, SLCAN),
    "websocket": (feed_websocket, WEBSOCKET),
    "json": (feed_json, JSON),
    "mjpeg": (feed_mjpeg, MJPEG),
    "dynamixel": (feed_dynamixel, b"".join(status(i, bytes([i, 255, 255, 253]), 0) for i in range(1, 9))),
    "spacemouse": (feed_spacemouse, b"".join(spacemouse.reports((1, -350, 0, 9, 350, -2), 3, "three"))),
}
NEVER_REFUSE = ("slcan", "dynamixel", "spacemouse")  # they count what is broken, and look for what isn't


@pytest.mark.parametrize("name", PARSERS)
def test_mutated_bytes_are_survived(name: str):
    feed, seed_bytes = PARSERS[name]
    rng, refused = np.random.default_rng(int(os.environ.get("UNIFORCE_FUZZ_SEED", "0"))), 0
    for i in range(INPUTS):
        data = mutate(rng, seed_bytes)
        began_s = time.process_time()
        try:
            feed(rng, data)
        except SensorError:
            refused += 1
        except Exception as error:  # the one place that looks for what nobody thought of
            pytest.fail(f"input {i}: {type(error).__name__}: {error}; bytes {data!r}")
        assert time.process_time() - began_s < SLOWEST_S, f"input {i} took too long: {data!r}"
    assert refused < INPUTS  # some still make sense, or nothing was tested
    assert name in NEVER_REFUSE or refused > 0


@pytest.mark.parametrize("name", PARSERS)
def test_what_is_not_mutated_is_accepted(name: str):
    feed, seed_bytes = PARSERS[name]
    feed(np.random.default_rng(0), seed_bytes)


@pytest.mark.parametrize("name", PARSERS)
def test_plain_noise_is_survived(name: str):
    feed, rng = PARSERS[name][0], np.random.default_rng(1)
    for _ in range(INPUTS // 10):
        try:
            feed(rng, rng.bytes(int(rng.integers(0, 2000))))
        except SensorError:
            continue


def test_deep_and_endless_json_is_refused():
    for text in (
        "[" * 500_000,
        '{"a":' * 200_000,
        "9" * 100_000,
        json.dumps({"type": "routine", "1": {"data": [[]] * 48}}),
    ):
        with pytest.raises(SensorError):
            read_message(text, "1", "fuzz")
