"""A camera behind ``http://``: bytes of an HTTP answer → JPEG images → frames.

The form is ``multipart/x-mixed-replace`` (RFC 2046 parts in one endless answer), as MJPEG streamers
send it; each part says its ``Content-Length``. Every buffer is bounded: an endless header is an
error.

Not PyAV: it ends at the first broken image (fault ``garbage``). Not httpx: its stream is over after
one read that timed out. OpenCV's own reader takes a second to open and waits 30 s for a silent
server.
"""

import base64
import re
import socket
import time
from contextlib import ExitStack
from io import BytesIO
from urllib.parse import unquote, urlsplit

import cv2
import numpy as np
from PIL.JpegImagePlugin import JpegImageFile

from uniforce_robots.sensors.camera_source import FrameSource
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import Stamped
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


class MultipartJpeg:
    """Collects the parts of one answer; no I/O. Errors call the sensor ``name``."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._buffer = bytearray()
        self._boundary = b""  # empty until the answer's own header has come
        self._length: int | None = None  # of the image that comes next; None where its header does

    def feed(self, chunk: bytes) -> list[bytes]:
        """Return the images that ``chunk`` completes.

        Raises ProtocolError: another status than 200, no multipart, no boundary, no length, or
        something beyond its limit.
        """
        self._buffer += chunk
        parts: list[bytes] = []
        while self._length is not None or self._take_header():
            if self._length is not None:
                if len(self._buffer) < self._length:
                    break
                parts.append(bytes(self._buffer[: self._length]))
                del self._buffer[: self._length]
                self._length = None
        return parts

    def _take_header(self) -> bool:
        """Take a header off the buffer; False when more bytes are needed."""
        while self._boundary and self._buffer[:2] == b"\r\n":  # the line end after an image
            del self._buffer[:2]
        end = self._buffer.find(_END, 0, MAX_HEADER_BYTES + len(_END))
        if end < 0:
            if len(self._buffer) > MAX_HEADER_BYTES:
                raise self._error("a header", f"{MAX_HEADER_BYTES} bytes without its end")
            return False
        first, *lines = bytes(self._buffer[:end]).split(b"\r\n")
        del self._buffer[: end + len(_END)]
        fields = {}
        for line in lines:
            name, _, value = line.partition(b":")
            fields[name.strip().lower()] = value.strip()
        if self._boundary:
            self._begin_part(first, fields)
        else:
            self._begin(first, fields)
        return True

    def _begin(self, status: bytes, fields: dict[bytes, bytes]) -> None:
        if not re.match(rb"HTTP/1\.[01] 200\b", status):
            raise self._error("status 200", status[:60].decode("latin-1"))
        kind = fields.get(b"content-type", b"")
        boundary = _BOUNDARY.search(kind)
        if not kind.lower().startswith(b"multipart/") or boundary is None:
            raise self._error(
                "multipart/x-mixed-replace with a boundary", kind[:60].decode("latin-1")
            )
        # some servers put the dashes into the name
        self._boundary = b"--" + boundary[1].removeprefix(b"--")

    def _begin_part(self, first: bytes, fields: dict[bytes, bytes]) -> None:
        if not first.startswith(self._boundary):
            raise self._error("a boundary", repr(first[:40]))
        length = fields.get(b"content-length", b"none")
        if not re.fullmatch(rb"[0-9]{1,10}", length) or int(length) > MAX_JPEG_BYTES:
            raise self._error(
                f"a Content-Length of at most {MAX_JPEG_BYTES} bytes", length[:40].decode("latin-1")
            )
        self._length = int(length)

    def _error(self, wanted: str, came: str) -> ProtocolError:
        return ProtocolError(
            expected(self._name, wanted, came, "Is this the address of an MJPEG stream?")
        )


class StreamSource(FrameSource):
    """A camera behind ``http://host:port/path``, or ``http://user:password@host:port/path``."""

    def _connect(self, undo: ExitStack) -> None:
        """Connect; raises LostSensorError where the address is none, or no server is there."""
        self._parser = MultipartJpeg(self.name)
        self._socket = undo.enter_context(_request(self._config.source))

    def read(self) -> list[Stamped]:
        """Return the newest whole image that came, or nothing; older ones are left out."""
        parts: list[bytes] = []
        deadline_s = time.monotonic() + READ_S
        for _ in range(MAX_CHUNKS):
            # once there is an image, take what else waits in the kernel: the newest counts
            chunk = self._receive(0.0 if parts else max(deadline_s - time.monotonic(), 0.0))
            if not chunk:
                break
            parts += self._parser.feed(chunk)
        if not parts:
            return []
        self.counts.lost += len(parts) - 1
        bgr = decode_bgr(parts[-1])
        if bgr is None:
            self.counts.bad += 1
            return []
        return [self._stamped(bgr)]

    def _receive(self, timeout_s: float) -> bytes:
        """Return what came; nothing when nothing does in time."""
        try:
            self._socket.settimeout(timeout_s)
            if chunk := self._socket.recv(CHUNK_BYTES):
                return chunk
            raise ConnectionError("its end")
        except (TimeoutError, BlockingIOError):
            return b""
        except OSError as error:
            do = "Is the server still running?"
            raise LostSensorError(expected(self.name, "an MJPEG stream", error, do)) from error


def decode_bgr(jpeg: bytes) -> np.ndarray | None:
    """Return the (H, W, 3) uint8 BGR image of a JPEG; None if it isn't one of a sensible size."""
    try:
        if max(JpegImageFile(BytesIO(jpeg)).size) > MAX_SIDE_PX:  # reads its header alone
            return None
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    except (SyntaxError, OSError, cv2.error):  # the first two are Pillow's
        return None  # the caller counts it as bad


def _request(url: str) -> socket.socket:
    do = "Give http://host:port/path of an MJPEG stream, and start its server."
    try:
        parts = urlsplit(url)
        host = parts.hostname
        port = parts.port or 80
        if parts.scheme != "http" or not host:
            raise ValueError("no http address")
    except ValueError as error:  # also a port that is no number, or half a bracket
        raise LostSensorError(
            expected("camera address", "http://host:port/path", url, do)
        ) from error
    target = parts.path or "/"
    if parts.query:
        target += f"?{parts.query}"
    login = ""
    if parts.username:
        pair = f"{unquote(parts.username)}:{unquote(parts.password or '')}".encode()
        login = f"Authorization: Basic {base64.b64encode(pair).decode()}\r\n"
    # HTTP/1.0: the answer is never chunked
    request = f"GET {target} HTTP/1.0\r\nHost: {host}:{port}\r\n{login}\r\n"
    try:
        connection = socket.create_connection((host, port), CONNECT_S)
        connection.sendall(request.encode())
    except OSError as error:
        raise LostSensorError(expected(url, "an MJPEG server", error, do)) from error
    return connection
