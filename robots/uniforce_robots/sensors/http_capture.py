"""A camera behind ``http://``: what ``cv2.VideoCapture`` offers, over the standard library's sockets.

OpenCV's own reader takes a second to open, hides when a frame was sent, and waits 30 s for a server that went silent.
"""

from __future__ import annotations

import base64
import socket
import time
from urllib.parse import SplitResult, unquote, urlsplit

import cv2
import numpy as np

from uniforce_robots.sensors.faults import LostSensorError
from uniforce_robots.sensors.multipart_jpeg import JpegPart, MultipartJpeg, is_safe_jpeg
from uniforce_vtla.errors import expected

CONNECT_S = 2.0
READ_S = 0.1  # one read waits this long for a frame
CHUNK_BYTES = 1 << 16
MAX_CHUNKS = 128  # of one read: 8 MB, more than a socket holds back


class HttpCapture:
    """One connection to an MJPEG stream.

    Args:
        url: ``http://host:port/path``, or ``http://user:password@host:port/path``.

    Attributes:
        bad: images that couldn't be decoded.
        skipped: whole images left out because a newer one had come already.

    Raises:
        LostSensorError: not an http address, nobody there.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.bad = self.skipped = 0
        self._parser = MultipartJpeg(url)
        self._taken_s: float | None = None
        self._socket: socket.socket | None = _request(url)

    def isOpened(self) -> bool:  # noqa: N802  cv2's name
        """Return whether the connection stands."""
        return self._socket is not None

    def set(self, prop: int, value: float) -> bool:
        """Refuse: a stream's settings are its server's."""
        return False

    def get(self, prop: int) -> float:
        """Return when the server took the newest image, in ms, for ``CAP_PROP_POS_MSEC``; 0 for all else."""
        known = prop == cv2.CAP_PROP_POS_MSEC and self._taken_s is not None
        return 1e3 * self._taken_s if known and self._taken_s is not None else 0.0

    def read(self) -> tuple[bool, np.ndarray | None]:
        """Return (True, (H, W, 3) uint8 BGR) of the newest whole image, or (False, None) if none came.

        Raises:
            LostSensorError: the server closed or broke the connection.
            ProtocolError: the answer isn't an MJPEG stream.
        """
        parts = self._receive()
        if not parts:
            return False, None
        self.skipped += len(parts) - 1
        image = decode_bgr(parts[-1].jpeg)
        if image is None:
            self.bad += 1
            return False, None
        self._taken_s = parts[-1].taken_s
        return True, image

    def release(self) -> None:
        """Close the connection."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _receive(self) -> list[JpegPart]:
        if self._socket is None:
            raise LostSensorError(expected(self.url, "an open stream", "closed", "Open it again."))
        parts: list[JpegPart] = []
        deadline_s = time.monotonic() + READ_S
        for _ in range(MAX_CHUNKS):
            # once there is an image, take what else waits in the kernel but wait for nothing: the newest counts
            wait_s = 0.0 if parts else max(deadline_s - time.monotonic(), 0.0)
            chunk = self._receive_chunk(self._socket, wait_s)
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
            raise LostSensorError(expected(self.url, "an MJPEG stream", error, do)) from error
        if not chunk:
            raise LostSensorError(expected(self.url, "an MJPEG stream", "its end", do))
        return chunk


def decode_bgr(jpeg: bytes) -> np.ndarray | None:
    """Return the (H, W, 3) uint8 BGR image of a JPEG; None if it isn't one."""
    if not is_safe_jpeg(jpeg):
        return None
    try:
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        return None  # the caller counts it as bad


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
    try:
        connection = socket.create_connection((host, port), CONNECT_S)
        # HTTP/1.0: the answer is never chunked
        request = f"GET {target} HTTP/1.0\r\nHost: {host}:{port}\r\n{_login(parts)}\r\n"
        connection.sendall(request.encode())
    except OSError as error:
        raise LostSensorError(expected(url, "an MJPEG server", error, do)) from error
    return connection
