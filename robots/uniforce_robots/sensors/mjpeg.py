"""A camera behind ``http://``: bytes of an HTTP answer → JPEG images → frames.

The form is ``multipart/x-mixed-replace`` (RFC 2046 parts in one endless answer), as MJPEG streamers send it.  Every
buffer is bounded: a server that never ends a header or an image is an error, not a full memory.

Not PyAV: it hides when a frame was sent (fault ``late``) and ends at the first image that is none (``garbage``).  Not
httpx: its stream is over after one read that timed out, and the parts would still be parsed here.  OpenCV's own reader
takes a second to open and waits 30 s for a silent server.
"""

from __future__ import annotations

import base64
import re
import socket
import time
from enum import Enum, auto
from typing import NamedTuple
from urllib.parse import SplitResult, unquote, urlsplit

import cv2
import numpy as np

from uniforce_robots.sensors.camera_source import FrameSource
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.samples import Stamped
from uniforce_vtla.errors import expected

CONNECT_S = 2.0
READ_S = 0.1  # one read waits this long for a frame
CHUNK_BYTES = 1 << 16
MAX_CHUNKS = 128  # of one read: 8 MB, more than a socket holds back
MAX_HEADER_BYTES = 8192
MAX_JPEG_BYTES = 8 << 20  # 1080p MJPEG frames have 0.2 to 0.8 MB
MAX_SIDE_PX = 4096  # a forged header may claim 65,535 × 65,535
_END = b"\r\n\r\n"
_BOUNDARY = re.compile(rb'boundary\s*=\s*"?([^"\s;]{1,200})"?', re.IGNORECASE)


class JpegPart(NamedTuple):
    """One image: its bytes, and when the server says it was taken (``X-Timestamp``, s), if it says."""

    jpeg: bytes
    taken_s: float | None


class _At(Enum):
    ANSWER = auto()
    PART = auto()
    IMAGE = auto()


class MultipartJpeg:
    """Collects the parts of one answer; no I/O.

    Args:
        name: how errors call the sensor.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._buffer = bytearray()
        self._at = _At.ANSWER
        self._boundary = b""
        self._length: int | None = None
        self._taken_s: float | None = None
        self._searched = 0  # bytes of an image without length in which its end was sought already

    def feed(self, chunk: bytes) -> list[JpegPart]:
        """Return the images that ``chunk`` completes.

        Raises:
            ProtocolError: another status than 200, no multipart, no boundary, or something beyond its limit.
        """
        self._buffer += chunk
        parts: list[JpegPart] = []
        while self._take_image(parts) if self._at is _At.IMAGE else self._take_header():
            pass
        return parts

    def _take_header(self) -> bool:
        """Take a header off the buffer; False when more bytes are needed."""
        while self._at is _At.PART and self._buffer[:2] == b"\r\n":  # the line end after an image
            del self._buffer[:2]
        end = self._buffer.find(_END, 0, MAX_HEADER_BYTES + len(_END))
        if end < 0:
            if len(self._buffer) > MAX_HEADER_BYTES:
                raise self._error("a header", f"{MAX_HEADER_BYTES} bytes without its end")
            return False
        first, *lines = bytes(self._buffer[:end]).split(b"\r\n")
        del self._buffer[: end + len(_END)]
        pairs = [line.partition(b":") for line in lines]
        fields = {name.strip().lower(): value.strip() for name, _, value in pairs}
        (self._begin if self._at is _At.ANSWER else self._begin_part)(first, fields)
        return True

    def _begin(self, status: bytes, fields: dict[bytes, bytes]) -> None:
        if not re.match(rb"HTTP/1\.[01] 200\b", status):
            raise self._error("status 200", status[:60].decode("latin-1"))
        kind = fields.get(b"content-type", b"")
        boundary = _BOUNDARY.search(kind)
        if not kind.lower().startswith(b"multipart/") or boundary is None:
            raise self._error("multipart/x-mixed-replace with a boundary", kind[:60].decode("latin-1"))
        self._boundary = b"--" + boundary[1].removeprefix(b"--")  # some servers put the dashes into the name
        self._at = _At.PART

    def _begin_part(self, first: bytes, fields: dict[bytes, bytes]) -> None:
        if not first.startswith(self._boundary):
            raise self._error("a boundary", repr(first[:40]))
        length, taken_s = fields.get(b"content-length"), fields.get(b"x-timestamp", b"")
        if length is not None and (not re.fullmatch(rb"[0-9]{1,10}", length) or int(length) > MAX_JPEG_BYTES):
            raise self._error(f"an image of at most {MAX_JPEG_BYTES} bytes", length[:40].decode("latin-1"))
        self._length = None if length is None else int(length)
        self._taken_s = float(taken_s) if re.fullmatch(rb"[0-9]{1,12}(\.[0-9]{1,9})?", taken_s) else None
        self._searched, self._at = 0, _At.IMAGE

    def _take_image(self, parts: list[JpegPart]) -> bool:
        length = self._sought_length() if self._length is None else self._length
        if length is None or len(self._buffer) < length:
            return False
        parts.append(JpegPart(bytes(self._buffer[:length]), self._taken_s))
        del self._buffer[:length]
        self._at = _At.PART
        return True

    def _sought_length(self) -> int | None:
        """Return where the next boundary is, for servers that don't say how long an image is."""
        mark = b"\r\n" + self._boundary
        end = self._buffer.find(mark, self._searched)
        self._searched = max(len(self._buffer) - len(mark), 0)  # never search the same bytes twice
        if end < 0 and len(self._buffer) > MAX_JPEG_BYTES:
            raise self._error("the end of an image", f"{MAX_JPEG_BYTES} bytes without it")
        return None if end < 0 else end

    def _error(self, wanted: str, came: str) -> ProtocolError:
        return ProtocolError(expected(self._name, wanted, came, "Is this the address of an MJPEG stream?"))


class StreamSource(FrameSource):
    """A camera behind ``http://host:port/path``, or ``http://user:password@host:port/path``."""

    _socket: socket.socket | None = None
    _parser: MultipartJpeg

    def open(self) -> None:
        """Connect; raises LostSensorError where the address is none, or no server is there."""
        self.close()
        self._parser = MultipartJpeg(self.name)
        self._socket = _request(self._source)

    def read(self) -> list[Stamped]:
        """Return the newest whole image that came, or nothing; older ones that came with it are left out.

        Raises:
            LostSensorError: the server closed or broke the connection.
            WrongSensorError: an image of another size than asked for.
            ProtocolError: the answer isn't an MJPEG stream, or no usable time although ``clock`` is "driver".
        """
        if self._socket is None:
            raise LostSensorError(expected(self.name, "an open stream", "closed", "Call open()."))
        parts = self._receive(self._socket)
        if not parts:
            return []
        self._skipped += len(parts) - 1
        bgr = decode_bgr(parts[-1].jpeg)
        if bgr is None:
            self._bad += 1
            return []
        return [self._stamped(bgr, 1e3 * (parts[-1].taken_s or 0.0))]

    def close(self) -> None:
        """Close the connection."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _receive(self, connection: socket.socket) -> list[JpegPart]:
        parts: list[JpegPart] = []
        deadline_s = time.monotonic() + READ_S
        for _ in range(MAX_CHUNKS):
            # once there is an image, take what else waits in the kernel but wait for nothing: the newest counts
            chunk = self._receive_chunk(connection, 0.0 if parts else max(deadline_s - time.monotonic(), 0.0))
            if not chunk:
                break
            parts += self._parser.feed(chunk)
        return parts

    def _receive_chunk(self, connection: socket.socket, timeout_s: float) -> bytes:
        """Return what came; nothing when nothing does in time."""
        do = "Is the server still running?"
        try:
            connection.settimeout(timeout_s)
            chunk = connection.recv(CHUNK_BYTES)
        except (TimeoutError, BlockingIOError):
            return b""
        except OSError as error:
            raise LostSensorError(expected(self.name, "an MJPEG stream", error, do)) from error
        if not chunk:
            raise LostSensorError(expected(self.name, "an MJPEG stream", "its end", do))
        return chunk


def decode_bgr(jpeg: bytes) -> np.ndarray | None:
    """Return the (H, W, 3) uint8 BGR image of a JPEG; None if it isn't one of a sensible size."""
    size = jpeg_size(jpeg)
    if size is None or min(size) <= 0 or max(size) > MAX_SIDE_PX:
        return None
    try:
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None  # the caller counts it as bad


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return (width, height) from a JPEG's frame header; None if it has none (ITU-T T.81, annex B)."""
    at = 2
    while jpeg[:2] == b"\xff\xd8" and at + 9 <= len(jpeg) and jpeg[at] == 0xFF:
        marker, length = jpeg[at + 1], int.from_bytes(jpeg[at + 2 : at + 4])
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(jpeg[at + 7 : at + 9]), int.from_bytes(jpeg[at + 5 : at + 7])
        at += 2 + max(length, 2)
    return None


def _login(parts: SplitResult) -> str:
    """Return the header line of a basic login, nothing where the address has none."""
    if parts.username is None:
        return ""
    pair = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
    return f"Authorization: Basic {base64.b64encode(pair.encode()).decode()}\r\n"


def _request(url: str) -> socket.socket:
    do = "Give http://host:port/path of an MJPEG stream, and start its server."
    parts = urlsplit(url)
    try:
        host, port = parts.hostname, parts.port or 80
    except ValueError as error:  # a port that is no number
        raise LostSensorError(expected("camera address", "http://host:port/path", url, do)) from error
    if parts.scheme != "http" or not host:
        raise LostSensorError(expected("camera address", "http://host:port/path", url, do))
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    # HTTP/1.0: the answer is never chunked
    request = f"GET {target} HTTP/1.0\r\nHost: {host}:{port}\r\n{_login(parts)}\r\n"
    try:
        connection = socket.create_connection((host, port), CONNECT_S)
        connection.sendall(request.encode())
    except OSError as error:
        raise LostSensorError(expected(url, "an MJPEG server", error, do)) from error
    return connection
