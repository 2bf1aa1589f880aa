"""xela_server with one uSkin patch: JSON over a WebSocket (RFC 6455, server side) on loopback.

Example: python -m uniforce_robots.standins.xela rate_hz=100

Prints ``ready HOST:PORT``.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import json
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.server import ServerProtocol

from uniforce_robots.standins.control import Pace, StandInServer
from uniforce_robots.standins.loopback import LoopbackServer
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.arguments import parse

OUT_BYTES = 1 << 20
FRAGMENTS = 5


@dataclass
class XelaConfig(Scene):
    """Show a simulated uSkin patch as a xela_server on loopback.

    Example: python -m uniforce_robots.standins.xela rate_hz=100
    """

    rate_hz: float = 100.0  # messages per second; real servers gave 95 to 133 for a 4×4 patch
    fault: str = "none"  # what is broken from the start
    port: int = 0  # 0 = any free one; xela_server's own is 5000


def frame(opcode: Opcode, payload: bytes, is_last: bool = True) -> bytes:
    """Return one unmasked frame (section 5.2)."""
    return Frame(opcode, payload, is_last).serialize(mask=False)


def fragmented(text: bytes, pieces: int) -> bytes:
    """Return a text in several frames, a ping between any two (section 5.4)."""
    size = max(-(-len(text) // pieces), 1)
    parts = [text[i * size : (i + 1) * size] for i in range(pieces)]
    framed = [frame(Opcode.CONT if i else Opcode.TEXT, p, i == pieces - 1) for i, p in enumerate(parts)]
    return frame(Opcode.PING, b"in between").join(framed)


def greeting(request: bytes) -> bytes:
    """Return the answer to a client's handshake (section 4.2.2), nothing where it asked for something else."""
    protocol = ServerProtocol()
    protocol.receive_data(request)
    asked = [event for event in protocol.events_received() if isinstance(event, Request)]
    if not asked:
        return b""
    protocol.send_response(protocol.accept(asked[0]))
    return b"".join(protocol.data_to_send())


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


class XelaStandIn(StandInServer):
    """The server: one simulated patch, any number of listeners."""

    faults = (
        *("welcome", "list", "integers", "null", "sim", "close", "stall", "freeze", "stop"),
        *("garbage", "short", "absent", "fragments", "ping", "badframe"),
    )

    def __init__(self, config: XelaConfig) -> None:
        self._server = LoopbackServer(config.port, OUT_BYTES)
        super().__init__(self._server, "{}:{}".format(*self._server.address), config.fault)
        self._cycle = taxel_cycle(config, config.rate_hz)
        self._pace = Pace(config.rate_hz)
        self._rng = np.random.default_rng(config.seed)
        self._step = self._number = 0

    def waits_for(self) -> tuple[list[Any], list[Any], float]:
        """Return the server's sockets and the time to the next message."""
        return self._server.reading(), self._server.writing(), self._pace.wait_s()

    def serve(self, ready: list[Any], writable: list[Any]) -> None:
        """Greet visitors, send the messages that are due."""
        self._server.receive(ready)
        for visitor, request in list(self._server.visitors.items()):
            if b"\r\n\r\n" in request:
                self._shake_hands(visitor, request)
        for _ in range(self._pace.due()):
            self._broadcast()
        self._server.flush(writable)

    def stats(self) -> str:
        """Return messages sent and dropped, and clients."""
        return self._server.stats()

    def on_fault(self) -> None:
        """Close the connections properly for ``close``."""
        if self.fault == "close":
            self._close_properly()
        super().on_fault()

    def _broadcast(self) -> None:
        if self.fault in ("welcome", "stall", "stop") or not self._server.clients:
            return  # the cycle begins, in free air, with the first who listens
        scan = self._cycle[self._step % len(self._cycle)]
        self._step += self.fault != "freeze"
        self._number += 1
        self._server.broadcast(self._frames(message(self._number, scan, self.fault).encode()))

    def _frames(self, text: bytes) -> bytes:
        if self.fault == "garbage" and self._number % 2:
            return frame(Opcode.TEXT, b'{"message": ' + self._rng.bytes(8).hex().encode())
        if self.fault == "badframe":
            return b"\xff\xff" + self._rng.bytes(20)
        if self.fault == "ping":
            return frame(Opcode.PING, b"are you there") + frame(Opcode.TEXT, text)
        return fragmented(text, FRAGMENTS if self.fault == "fragments" else 1)

    def _shake_hands(self, client: socket.socket, request: bytes) -> None:
        answer = greeting(request)
        if not answer:
            self._server.part_from(client)
            return
        welcome = json.dumps({"message": "Welcome", "time": time.time()}).encode()
        self._server.admit(client, answer + frame(Opcode.TEXT, welcome))

    def _close_properly(self) -> None:
        for client, out in list(self._server.clients.items()):
            with contextlib.suppress(OSError):
                client.send(bytes(out) + frame(Opcode.CLOSE, (1001).to_bytes(2)))
            self._server.part_from(client)


if __name__ == "__main__":
    sys.exit(XelaStandIn(parse(XelaConfig)).run())
