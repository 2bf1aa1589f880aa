"""xela_server with one uSkin patch: JSON over a WebSocket on loopback; see ``--help``."""

import json
import sys
import time
from dataclasses import dataclass

from websockets.frames import Frame, Opcode
from websockets.http11 import Request
from websockets.server import ServerProtocol

from uniforce_robots.standins.control import StandInServer
from uniforce_robots.standins.plugs import READ_BYTES, Sockets
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.arguments import parse

FRAGMENTS = 5


@dataclass
class XelaConfig(Scene):
    """Show a simulated uSkin patch as a xela_server on loopback.

    Example: cd tests; python -m standins.xela rate_hz=100
    """

    rate_hz: float = 100.0  # messages per second; real servers gave 95 to 133 for a 4×4 patch
    fault: str = "none"  # what is broken from the start


def frame(opcode, payload, is_last=True):
    """Return one unmasked frame (section 5.2)."""
    return Frame(opcode, payload, is_last).serialize(mask=False)


def fragmented(text, pieces):
    """Return a text in several frames, a ping between any two (section 5.4)."""
    size = max(-(-len(text) // pieces), 1)
    parts = [text[i * size : (i + 1) * size] for i in range(pieces)]
    framed = [
        frame(Opcode.CONT if i else Opcode.TEXT, p, i == pieces - 1) for i, p in enumerate(parts)
    ]
    return frame(Opcode.PING, b"in between").join(framed)


def greeting(request):
    """Return the answer to a client's handshake (section 4.2.2), nothing to another request."""
    protocol = ServerProtocol()
    protocol.receive_data(request)
    asked = [event for event in protocol.events_received() if isinstance(event, Request)]
    if not asked:
        return b""
    protocol.send_response(protocol.accept(asked[0]))
    return b"".join(protocol.data_to_send())


def welcome(client):
    """Return that answer, and xela_server's first message with it."""
    text = json.dumps({"message": "Welcome", "time": time.time()}).encode()
    return greeting(client.recv(READ_BYTES)) + frame(Opcode.TEXT, text)


def message(number, scan, fault):
    """Return the server's text for one (16, 3) uint16 scan, with the named peculiarity."""
    words = [f"{count:04X}" for count in scan.ravel().tolist()]
    forms = {"short": ",".join(words[:30]), "list": words, "integers": scan.ravel().tolist()}
    now = time.time()
    sensor = {"time": now, "sensor": "1", "model": "XR1944", "taxels": 16, "temp": [301.0] * 16}
    sensor["data"] = forms.get(fault, ",".join(words))
    if fault == "null":
        sensor["calibrated"] = None
    body = {"message": number, "time": now, "sensors": 1, "type": "routine", "version": "1.7.6"}
    body["sendtime"] = now
    body["2" if fault == "absent" else "1"] = sensor
    if fault == "sim":
        body["bustype"] = "sim"
    return json.dumps(body)


class XelaStandIn(StandInServer):
    """The server: one simulated patch, any number of listeners."""

    faults = (
        *("welcome", "list", "integers", "null", "sim", "close", "stall", "freeze", "stop"),
        *("garbage", "short", "absent", "fragments", "ping", "badframe"),
    )

    def __init__(self, config):
        self._cycle = taxel_cycle(config, config.rate_hz)
        self._server = Sockets(("127.0.0.1", 0), welcome)
        super().__init__(self._server, "{}:{}".format(*self._server.where), config, config.rate_hz)
        self._number = 0

    def on_fault(self):
        if self.fault == "close":
            self.plug.send(frame(Opcode.CLOSE, (1001).to_bytes(2)))
            self.plug.flush()
            self.plug.unplug()
        super().on_fault()

    def beat(self):
        """Send a message; the cycle begins, in free air, with the first client."""
        if self.fault in ("welcome", "stall", "stop") or not self._server.clients:
            return
        self._number += 1
        scan = self._cycle[self.next_step() % len(self._cycle)]
        text = message(self._number, scan, self.fault).encode()
        if self.fault == "badframe":
            self.plug.send(b"\xff\xff" + self.rng.bytes(20))
        elif self.fault == "garbage" and self._number % 2:
            self.plug.send(frame(Opcode.TEXT, b'{"message": ' + self.rng.bytes(8).hex().encode()))
        else:
            ping = frame(Opcode.PING, b"are you there") if self.fault == "ping" else b""
            self.plug.send(ping + fragmented(text, FRAGMENTS if self.fault == "fragments" else 1))


if __name__ == "__main__":
    sys.exit(XelaStandIn(parse(XelaConfig)).run())
