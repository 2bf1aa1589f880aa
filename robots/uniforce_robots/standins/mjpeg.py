"""A tactile camera behind HTTP: multipart MJPEG on loopback.

Example: python -m uniforce_robots.standins.mjpeg sensor=tactip

Prints ``ready URL``.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import select
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from uniforce_robots.standins.control import Control
from uniforce_robots.standins.loopback import LoopbackServer
from uniforce_robots.standins.pace import Pace
from uniforce_robots.standins.scene import SceneConfig, frame_cycle
from uniforce_vtla.arguments import parse

FAULTS = ("stop", "stall", "freeze", "size", "late", "garbage", "nolength")
BOUNDARY = b"uniforceframe"
KIND = b"multipart/x-mixed-replace; boundary=" + BOUNDARY
WELCOME = b"HTTP/1.0 200 OK\r\nContent-Type: " + KIND + b"\r\n\r\n"
LATE_S = 0.6  # how long "late" holds frames back
OUT_BYTES = 4 << 20  # a client that doesn't read loses frames, as behind a real streamer
JPEG_QUALITY = 90


@dataclass
class MjpegConfig(SceneConfig):
    """Show a simulated GelSight or TacTip as an MJPEG stream on loopback.

    Example: python -m uniforce_robots.standins.mjpeg sensor=gelsight rate_hz=30
    """

    sensor: str = "tactip"  # gelsight | tactip
    rate_hz: float = 30.0  # frames per second
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


class MjpegStandIn:
    """The streamer: one simulated camera, any number of clients."""

    def __init__(self, config: MjpegConfig) -> None:
        frames = frame_cycle(config.sensor, config.scene, config.rate_hz)
        self._jpegs = [encode(frame) for frame in frames]
        self._small = encode(cv2.resize(frames[0], (320, 240)))
        self._rng = np.random.default_rng(config.seed)
        self._pace = Pace(config.rate_hz)
        self._held: deque[tuple[float, int]] = deque()  # frames "late" holds back: when taken, which
        self._step = 0
        self._server = LoopbackServer(config.port, OUT_BYTES)
        self._control = Control(FAULTS, self._on_fault, self._server.stats, config.fault)

    def run(self) -> None:
        """Serve until told to quit."""
        host, port = self._server.address
        self._control.ready(f"http://{host}:{port}/stream")
        while not self._control.quit:
            self._serve_once()

    def _serve_once(self) -> None:
        reading: list[Any] = [*self._server.reading(), *self._control.inputs()]
        ready, writable, _ = select.select(reading, self._server.writing(), [], self._pace.wait_s())
        if 0 in ready:
            self._control.read()
        for connection in ready:
            self._server.hear(connection)
        for visitor in list(self._server.visitors):
            self._server.admit(visitor, WELCOME)  # whatever was asked for
        if self._pace.due():
            self._show()
        self._server.flush(writable)

    # -- frames -----------------------------------------------------------------------------------------

    def _show(self) -> None:
        fault = self._control.fault
        if not self._server.clients:
            return  # the cycle begins, in free air, with the first who looks
        self._step += fault != "freeze"
        self._held.append((time.monotonic(), self._step))
        wait_s = LATE_S if fault == "late" else 0.0
        while self._held and self._held[0][0] <= time.monotonic() - wait_s:
            taken_s, step = self._held.popleft()
            if fault not in ("stall", "stop"):
                self._server.broadcast(self._part(fault, taken_s, step))

    def _part(self, fault: str, taken_s: float, step: int) -> bytes:
        jpeg = self._jpegs[step % len(self._jpegs)]
        if fault == "size":
            jpeg = self._small
        if fault == "garbage" and step % 2:
            jpeg = self._rng.bytes(2000)
        return part(jpeg, taken_s, with_length=fault != "nolength")

    def _on_fault(self, name: str) -> None:
        if name == "stop":
            self._server.unplug()
        else:
            self._server.listen()


def main(argv: list[str] | None = None) -> int:
    """Entry of ``python -m uniforce_robots.standins.mjpeg``."""
    cv2.setNumThreads(1)
    with contextlib.suppress(KeyboardInterrupt):
        MjpegStandIn(parse(MjpegConfig, argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
