"""A tactile camera behind HTTP: multipart MJPEG on loopback.

Example: python -m uniforce_robots.standins.mjpeg sensor=tactip

Prints ``ready URL``.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from uniforce_robots.standins.control import Pace, StandInServer
from uniforce_robots.standins.loopback import LoopbackServer
from uniforce_robots.standins.scene import Scene, frame_cycle
from uniforce_vtla.arguments import parse

BOUNDARY = b"uniforceframe"
KIND = b"multipart/x-mixed-replace; boundary=" + BOUNDARY
WELCOME = b"HTTP/1.0 200 OK\r\nContent-Type: " + KIND + b"\r\n\r\n"
LATE_S = 0.6  # how long "late" holds frames back
OUT_BYTES = 4 << 20  # a client that doesn't read loses frames, as behind a real streamer
JPEG_QUALITY = 90


@dataclass
class MjpegConfig(Scene):
    """Show a simulated GelSight or TacTip as an MJPEG stream on loopback.

    Example: python -m uniforce_robots.standins.mjpeg sensor=gelsight rate_hz=30
    """

    sensor: str = "tactip"  # gelsight | tactip
    rate_hz: float = 30.0  # frames per second
    fault: str = "none"  # what is broken from the start
    port: int = 0  # 0 = any free one


def encode(frame: np.ndarray) -> bytes:
    """Return the JPEG of an (H, W, 3) uint8 RGB frame."""
    bgr = cv2.cvtColor(frame, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def part(jpeg: bytes, taken_s: float, with_length: bool = True) -> bytes:
    """Return one part of the stream; ``taken_s`` is on the host's monotonic clock."""
    length = b"Content-Length: %d\r\n" % len(jpeg) if with_length else b""
    header = b"--%s\r\nContent-Type: image/jpeg\r\n%sX-Timestamp: %.6f\r\n\r\n" % (BOUNDARY, length, taken_s)
    return header + jpeg + b"\r\n"


class MjpegStandIn(StandInServer):
    """The streamer: one simulated camera, any number of clients."""

    faults = ("stop", "stall", "freeze", "size", "late", "garbage", "nolength")

    def __init__(self, config: MjpegConfig) -> None:
        cv2.setNumThreads(1)
        frames = frame_cycle(config.sensor, config, config.rate_hz)
        self._jpegs = [encode(frame) for frame in frames]
        self._small = encode(cv2.resize(frames[0], (320, 240)))
        self._rng = np.random.default_rng(config.seed)
        self._pace = Pace(config.rate_hz)
        self._held: deque[tuple[float, int]] = deque()  # frames "late" holds back: when taken, which
        self._step = 0
        self._server = LoopbackServer(config.port, OUT_BYTES)
        super().__init__(self._server, "http://{}:{}/stream".format(*self._server.address), config.fault)

    def waits_for(self) -> tuple[list[Any], list[Any], float]:
        """Return the server's sockets and the time to the next frame."""
        return self._server.reading(), self._server.writing(), self._pace.wait_s()

    def serve(self, ready: list[Any], writable: list[Any]) -> None:
        """Welcome whoever asks for whatever, send the frames that are due."""
        self._server.receive(ready)
        for visitor in list(self._server.visitors):
            self._server.admit(visitor, WELCOME)
        if self._pace.due():
            self._show()
        self._server.flush(writable)

    def stats(self) -> str:
        """Return frames sent and dropped, and clients."""
        return self._server.stats()

    def _show(self) -> None:
        if not self._server.clients:
            return  # the cycle begins, in free air, with the first who looks
        self._step += self.fault != "freeze"
        self._held.append((time.monotonic(), self._step))
        wait_s = LATE_S if self.fault == "late" else 0.0
        while self._held and self._held[0][0] <= time.monotonic() - wait_s:
            taken_s, step = self._held.popleft()
            if self.fault not in ("stall", "stop"):
                self._server.broadcast(self._part(taken_s, step))

    def _part(self, taken_s: float, step: int) -> bytes:
        jpeg = self._jpegs[step % len(self._jpegs)]
        if self.fault == "size":
            jpeg = self._small
        if self.fault == "garbage" and step % 2:
            jpeg = self._rng.bytes(2000)
        return part(jpeg, taken_s, with_length=self.fault != "nolength")


if __name__ == "__main__":
    sys.exit(MjpegStandIn(parse(MjpegConfig)).run())
