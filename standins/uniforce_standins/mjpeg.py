"""A tactile camera behind HTTP: multipart MJPEG on loopback.

Example: python -m uniforce_standins.mjpeg sensor=tactip

Prints ``ready URL``.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import select
import socket
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from uniforce_standins.control import Control
from uniforce_standins.pace import Pace
from uniforce_standins.scene import Scene, frame_cycle
from uniforce_vtla.commands.arguments import parse

FAULTS = ("stop", "stall", "freeze", "size", "late", "garbage", "nolength")
LOOPBACK = "127.0.0.1"
BOUNDARY = b"uniforceframe"
LATE_S = 0.6  # how long "late" holds frames back
OUT_BYTES = 4 << 20  # a client that doesn't read loses frames, as behind a real streamer
JPEG_QUALITY = 90


@dataclass
class MjpegConfig:
    """Show a simulated GelSight or TacTip as an MJPEG stream on loopback.

    Example: python -m uniforce_standins.mjpeg sensor=gelsight rate_hz=30
    """

    sensor: str = "tactip"  # gelsight | tactip
    rate_hz: float = 30.0  # frames per second
    port: int = 0  # 0 = any free one
    rest_s: float = 1.0  # free air at the start of each cycle
    press_s: float = 2.0  # then a press that comes and goes; 0 = never
    peak_N: float = 8.0  # its strongest normal force
    where: str = "centre"  # centre | top-left | top-right | bottom-left | bottom-right, in the camera's image
    hold: bool = False  # pressed from the start and for ever
    fault: str = "none"  # what is broken from the start
    seed: int = 0


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
        scene = Scene(
            config.rest_s,
            config.press_s,
            config.peak_N,
            where=config.where,
            hold=config.hold,
            seed=config.seed,
        )
        frames = frame_cycle(config.sensor, scene, config.rate_hz)
        self._jpegs = [encode(frame) for frame in frames]
        self._small = encode(cv2.resize(frames[0], (320, 240)))
        self._rng = np.random.default_rng(config.seed)
        self._pace = Pace(config.rate_hz)
        self._clients: dict[socket.socket, bytearray] = {}
        self._held: deque[tuple[float, int]] = deque()  # frames "late" holds back: when taken, which
        self._step = self._sent = self._dropped = 0
        self._listener: socket.socket | None = None
        self._address = (LOOPBACK, config.port)
        self._listen()
        self._control = Control(FAULTS, self._on_fault, self._stats, config.fault)

    def run(self) -> None:
        """Serve until told to quit."""
        self._control.ready(f"http://{self._address[0]}:{self._address[1]}/stream")
        while not self._control.quit:
            self._serve_once()

    def _serve_once(self) -> None:
        listening = [self._listener] if self._listener is not None else []
        writing = [client for client, out in self._clients.items() if out]
        reading: list[Any] = [*listening, *self._clients, *self._control.inputs()]
        ready, writable, _ = select.select(reading, writing, [], self._pace.wait_s())
        if 0 in ready:
            self._control.read()
        if self._listener is not None and self._listener in ready:
            self._welcome()
        for client in [c for c in ready if c in self._clients]:
            self._hear(client)
        if self._pace.due():
            self._show()
        for client in [c for c in writable if c in self._clients]:
            self._flush(client)

    # -- frames -----------------------------------------------------------------------------------------

    def _show(self) -> None:
        fault = self._control.fault
        if not self._clients:
            return  # the cycle begins, in free air, with the first who looks
        self._step += fault != "freeze"
        self._held.append((time.monotonic(), self._step))
        wait_s = LATE_S if fault == "late" else 0.0
        while self._held and self._held[0][0] <= time.monotonic() - wait_s:
            taken_s, step = self._held.popleft()
            if fault not in ("stall", "stop"):
                self._send(self._part(fault, taken_s, step))

    def _part(self, fault: str, taken_s: float, step: int) -> bytes:
        jpeg = self._jpegs[step % len(self._jpegs)]
        if fault == "size":
            jpeg = self._small
        if fault == "garbage" and step % 2:
            jpeg = self._rng.bytes(2000)
        return part(jpeg, taken_s, with_length=fault != "nolength")

    def _send(self, data: bytes) -> None:
        for out in self._clients.values():
            if len(out) + len(data) > OUT_BYTES:
                self._dropped += 1
            else:
                self._sent += 1
                out += data

    # -- clients ----------------------------------------------------------------------------------------

    def _welcome(self) -> None:
        assert self._listener is not None
        client, _ = self._listener.accept()
        client.setblocking(False)
        kind = b"multipart/x-mixed-replace; boundary=" + BOUNDARY
        self._clients[client] = bytearray(b"HTTP/1.0 200 OK\r\nContent-Type: " + kind + b"\r\n\r\n")

    def _hear(self, client: socket.socket) -> None:
        try:
            heard = client.recv(4096)
        except OSError:
            heard = b""
        if not heard:
            self._part_from(client)

    def _flush(self, client: socket.socket) -> None:
        out = self._clients[client]
        try:
            del out[: client.send(out)]
        except BlockingIOError:
            return
        except OSError:
            self._part_from(client)

    def _part_from(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()

    # -- plugging ---------------------------------------------------------------------------------------

    def _on_fault(self, name: str) -> None:
        if name == "stop":
            self._unplug()
        elif self._listener is None:
            self._listen()

    def _listen(self) -> None:
        self._listener = socket.create_server(self._address)  # sets SO_REUSEADDR: the same port after "stop"
        self._address = self._listener.getsockname()[:2]

    def _unplug(self) -> None:
        for client in list(self._clients):
            self._part_from(client)
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def _stats(self) -> str:
        return f"sent={self._sent} dropped={self._dropped} clients={len(self._clients)}"


def main(argv: list[str] | None = None) -> int:
    """Entry of ``python -m uniforce_standins.mjpeg``."""
    cv2.setNumThreads(1)
    with contextlib.suppress(KeyboardInterrupt):
        MjpegStandIn(parse(MjpegConfig, argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
