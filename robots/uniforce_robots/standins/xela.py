"""xela_server with one uSkin patch: JSON over a WebSocket (RFC 6455, server side) on loopback.

Example: python -m uniforce_robots.standins.xela rate_hz=100

Prints ``ready HOST:PORT``.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import re
import select
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from uniforce_robots.standins.control import Control
from uniforce_robots.standins.loopback import LoopbackServer
from uniforce_robots.standins.pace import Pace
from uniforce_robots.standins.scene import SceneConfig, taxel_cycle
from uniforce_vtla.arguments import parse

FAULTS = (
    *("welcome", "list", "integers", "null", "sim", "close", "stall", "freeze", "stop"),
    *("garbage", "short", "absent", "fragments", "ping", "badframe"),
)
GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
TEXT, CLOSE, PING = 0x1, 0x8, 0x9
OUT_BYTES = 1 << 20
FRAGMENTS = 5


@dataclass
class XelaConfig(SceneConfig):
    """Show a simulated uSkin patch as a xela_server on loopback.

    Example: python -m uniforce_robots.standins.xela rate_hz=100
    """

    rate_hz: float = 100.0  # messages per second; real servers gave 95 to 133 for a 4×4 patch
    port: int = 0  # 0 = any free one; xela_server's own is 5000


def frame(opcode: int, payload: bytes, is_last: bool = True) -> bytes:
    """Return one unmasked frame (section 5.2)."""
    size = len(payload)
    head = bytes([(0x80 if is_last else 0) | opcode])
    if size < 126:
        return head + bytes([size]) + payload
    if size < 65_536:
        return head + b"\x7e" + size.to_bytes(2) + payload
    return head + b"\x7f" + size.to_bytes(8) + payload


def message(number: int, scan: np.ndarray, fault: str) -> str:
    """Return the server's text for one (16, 3) uint16 scan, with the named peculiarity."""
    words: list = [f"{count:04X}" for count in scan.ravel().tolist()]
    data: object = ",".join(words[:30] if fault == "short" else words)
    if fault == "list":
        data = words
    elif fault == "integers":
        data = scan.ravel().tolist()
    now = time.time()
    sensor = {"time": now, "sensor": "1", "model": "XR1944", "taxels": 16, "data": data, "temp": [301.0] * 16}
    if fault == "null":
        sensor["calibrated"] = None
    body: dict[str, object] = {"message": number, "time": now, "sensors": 1, "type": "routine"}
    body["2" if fault == "absent" else "1"] = sensor
    if fault == "sim":
        body["bustype"] = "sim"
    return json.dumps(body | {"version": "1.7.6", "sendtime": now})


class XelaStandIn:
    """The server: one simulated patch, any number of listeners."""

    def __init__(self, config: XelaConfig) -> None:
        self._cycle = taxel_cycle(config.scene, config.rate_hz)
        self._pace = Pace(config.rate_hz)
        self._rng = np.random.default_rng(config.seed)
        self._step = self._number = 0
        self._server = LoopbackServer(config.port, OUT_BYTES)
        self._control = Control(FAULTS, self._on_fault, self._server.stats, config.fault)

    def run(self) -> None:
        """Serve until told to quit."""
        self._control.ready("{}:{}".format(*self._server.address))
        while not self._control.quit:
            self._serve_once()

    def _serve_once(self) -> None:
        reading: list[Any] = [*self._server.reading(), *self._control.inputs()]
        ready, writable, _ = select.select(reading, self._server.writing(), [], self._pace.wait_s())
        if 0 in ready:
            self._control.read()
        for connection in ready:
            heard = self._server.hear(connection)
            if connection in self._server.visitors:
                self._shake_hands(connection, self._server.visitors[connection] + heard)
        for _ in range(self._pace.due()):
            self._broadcast()
        self._server.flush(writable)

    # -- data -------------------------------------------------------------------------------------------

    def _broadcast(self) -> None:
        fault = self._control.fault
        if fault in ("welcome", "stall", "stop") or not self._server.clients:
            return  # the cycle begins, in free air, with the first who listens
        scan = self._cycle[self._step % len(self._cycle)]
        self._step += fault != "freeze"
        self._number += 1
        data = self._frames(message(self._number, scan, fault).encode(), fault)
        self._server.broadcast(data)

    def _frames(self, text: bytes, fault: str) -> bytes:
        if fault == "garbage" and self._number % 2:
            return frame(TEXT, b'{"message": ' + self._rng.bytes(8).hex().encode())
        if fault == "badframe":
            return b"\xff\xff" + self._rng.bytes(20)
        if fault == "ping":
            return frame(PING, b"are you there") + frame(TEXT, text)
        if fault != "fragments":
            return frame(TEXT, text)
        size = -(-len(text) // FRAGMENTS)
        pieces = [text[i : i + size] for i in range(0, len(text), size)]
        framed = [frame(0 if i else TEXT, p, i == len(pieces) - 1) for i, p in enumerate(pieces)]
        return frame(PING, b"in between").join(framed)  # control frames may come between fragments

    # -- clients ----------------------------------------------------------------------------------------

    def _shake_hands(self, client: socket.socket, request: bytes) -> None:
        self._server.visitors[client] = request[-8192:]
        key = re.search(rb"Sec-WebSocket-Key:\s*(\S+)", request, re.IGNORECASE)
        if b"\r\n\r\n" not in request or key is None:
            return
        accept = base64.b64encode(hashlib.sha1(key[1] + GUID).digest())
        answer = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        welcome = frame(TEXT, json.dumps({"message": "Welcome", "time": time.time()}).encode())
        self._server.admit(client, answer + b"Sec-WebSocket-Accept: " + accept + b"\r\n\r\n" + welcome)

    def _on_fault(self, name: str) -> None:
        if name == "close":
            self._say_goodbye()
        if name == "stop":
            self._server.unplug()
        else:
            self._server.listen()

    def _say_goodbye(self) -> None:
        for client, out in list(self._server.clients.items()):
            with contextlib.suppress(OSError):
                client.send(bytes(out) + frame(CLOSE, (1001).to_bytes(2)))
            self._server.part_from(client)


def main(argv: list[str] | None = None) -> int:
    """Entry of ``python -m uniforce_robots.standins.xela``."""
    with contextlib.suppress(KeyboardInterrupt):
        XelaStandIn(parse(XelaConfig, argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
