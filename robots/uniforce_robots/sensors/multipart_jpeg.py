"""Bytes of an HTTP answer → JPEG images; no I/O.

The form is ``multipart/x-mixed-replace`` (RFC 2046 parts in one endless answer), as MJPEG streamers send it.  Every
buffer is bounded: a server that never ends a header or an image is an error, not a full memory.
"""

from __future__ import annotations

import math
import re
from enum import Enum, auto
from typing import NamedTuple

from uniforce_robots.sensors.faults import ProtocolError
from uniforce_vtla.errors import expected

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
    """Collects the parts of one answer.

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
        while self._advance(parts):
            pass
        return parts

    def _advance(self, parts: list[JpegPart]) -> bool:
        """Take one piece off the buffer; False when more bytes are needed."""
        if self._at is _At.IMAGE:
            return self._take_image(parts)
        header = self._take_header()
        if header is None:
            return False
        if self._at is _At.ANSWER:
            self._begin(header)
        else:
            self._begin_part(header)
        return True

    def _take_header(self) -> bytes | None:
        if self._at is _At.PART:
            while self._buffer[:2] == b"\r\n":  # the line end after an image
                del self._buffer[:2]
        end = self._buffer.find(_END, 0, MAX_HEADER_BYTES + len(_END))
        if end < 0:
            if len(self._buffer) > MAX_HEADER_BYTES:
                raise self._error("a header", f"{MAX_HEADER_BYTES} bytes without its end")
            return None
        header = bytes(self._buffer[:end])
        del self._buffer[: end + len(_END)]
        return header

    def _begin(self, header: bytes) -> None:
        status = header.split(b"\r\n", 1)[0]
        if not re.match(rb"HTTP/1\.[01] 200\b", status):
            raise self._error("status 200", status[:60].decode("latin-1"))
        fields = _fields(header)
        kind = fields.get(b"content-type", b"")
        boundary = _BOUNDARY.search(kind)
        if not kind.lower().startswith(b"multipart/") or boundary is None:
            raise self._error("multipart/x-mixed-replace with a boundary", kind[:60].decode("latin-1"))
        self._boundary = b"--" + boundary[1].removeprefix(b"--")  # some servers put the dashes into the name
        self._at = _At.PART

    def _begin_part(self, header: bytes) -> None:
        if not header.startswith(self._boundary):
            raise self._error("a boundary", repr(header[:40]))
        fields = _fields(header)
        self._length = self._content_length(fields.get(b"content-length"))
        self._taken_s = _seconds(fields.get(b"x-timestamp"))
        self._searched = 0
        self._at = _At.IMAGE

    def _content_length(self, text: bytes | None) -> int | None:
        if text is None:
            return None
        if not re.fullmatch(rb"[0-9]{1,10}", text) or int(text) > MAX_JPEG_BYTES:
            raise self._error(f"an image of at most {MAX_JPEG_BYTES} bytes", text[:40].decode("latin-1"))
        return int(text)

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


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return (width, height) from a JPEG's frame header; None if it has none (ITU-T T.81, annex B)."""
    at = 2
    while jpeg[:2] == b"\xff\xd8" and at + 9 <= len(jpeg) and jpeg[at] == 0xFF:
        marker, length = jpeg[at + 1], int.from_bytes(jpeg[at + 2 : at + 4])
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(jpeg[at + 7 : at + 9]), int.from_bytes(jpeg[at + 5 : at + 7])
        at += 2 + max(length, 2)
    return None


def is_safe_jpeg(jpeg: bytes) -> bool:
    """Return whether a decoder may be trusted with these bytes: a JPEG that says it is of a sensible size."""
    size = jpeg_size(jpeg)
    return size is not None and min(size) > 0 and max(size) <= MAX_SIDE_PX


def _fields(header: bytes) -> dict[bytes, bytes]:
    pairs = [line.partition(b":") for line in header.split(b"\r\n")[1:]]
    return {name.strip().lower(): value.strip() for name, _, value in pairs}


def _seconds(text: bytes | None) -> float | None:
    if text is None or not re.fullmatch(rb"[0-9]{1,12}(\.[0-9]{1,9})?", text):
        return None
    seconds = float(text)
    return seconds if math.isfinite(seconds) else None
