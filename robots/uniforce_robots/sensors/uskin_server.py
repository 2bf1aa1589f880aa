"""uSkin through the maker's xela_server: several programs may listen, at the server's rate.

It binds its LAN address only (1.7.6) and is delivered with a simulated bus, whose data looks alive.
That is refused where the server says so, but not every version does: look into xServ.ini. Never run
against the real server.

First comes ``{"message": "Welcome", …}``, then messages of ``type`` "routine" with one object per
sensor number. Its ``data`` holds X, Y, Z of each taxel row by row: 48 hex words as one text, or as
a list. ``calibrated`` is not used. Source: XELA uSPa manual, 2023, and clients published by users.
"""

import json
import re
import socket
import time
from contextlib import ExitStack, suppress
from typing import Any

import numpy as np
from websockets.client import ClientProtocol
from websockets.frames import DATA_OPCODES, Frame
from websockets.protocol import State
from websockets.uri import parse_uri

from uniforce_robots.sensors import faults
from uniforce_robots.sensors.reader import SampleSource, Stamped, now_ns
from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import ContractError, expected

READ_S = 0.05
CONNECT_S = 2.0
PORT = 5000  # xela_server's default
CHUNK_BYTES = 1 << 16
MAX_MESSAGE_BYTES = 1 << 20  # a server message of 16 taxels has about 2 KB
WORDS = TAXEL_SHAPE[0] * TAXEL_SHAPE[1]
FULL_SCALE = 65_535
IS_IT = "Is this xela_server's port?"
_HEX = re.compile(r"\s*[0-9A-Fa-f]{1,4}\s*")
_BUS_FIELDS = ("bustype", "bus_type", "bus")


class XelaMessages:
    """Server bytes → texts, by the protocol half of ``websockets``; no I/O.

    Its connection classes read into a queue in a thread of their own: old messages would pass for
    new.

    ``host`` and ``port`` are named in the handshake, ``name`` in errors.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        self._name = name
        self._parts: list[bytes] = []
        self.protocol = ClientProtocol(
            parse_uri(f"ws://{host}:{port}/"), max_size=MAX_MESSAGE_BYTES
        )
        self.protocol.send_request(self.protocol.connect())

    def feed(self, chunk: bytes) -> list[str]:
        """Return the texts that ``chunk`` completes; an empty chunk is the end of the stream.

        Raises ProtocolError: no handshake, frames the RFC forbids, or text that isn't UTF-8.
        """
        if chunk:
            self.protocol.receive_data(chunk)
        else:
            self.protocol.receive_eof()
        error = self.protocol.handshake_exc or self.protocol.parser_exc
        if error is not None and not isinstance(error, EOFError):
            raise faults.ProtocolError(
                expected(self._name, "a WebSocket server (RFC 6455)", error, IS_IT)
            ) from error
        texts = []
        for event in self.protocol.events_received():
            if isinstance(event, Frame) and event.opcode in DATA_OPCODES:
                text = self._assembled(event)
                if text is not None:
                    texts.append(text)
        return texts

    def _assembled(self, frame: Frame) -> str | None:
        if frame.data:  # endless empty fragments must not pile up
            self._parts.append(bytes(frame.data))
        if not frame.fin:
            return None
        whole = b"".join(self._parts)
        self._parts = []
        try:
            return whole.decode()
        except UnicodeDecodeError as error:
            raise faults.ProtocolError(expected(self._name, "UTF-8 text", error, IS_IT)) from error


class ServerUSkin(SampleSource):
    """Whole scans, (16, 3) uint16 raw counts each, of one sensor of xela_server's messages.

    Its address is ``host`` or ``host:port``; ContractError where it has no such form.
    """

    def __init__(self, address: str, sensor: str = "1", name: str = "uskin") -> None:
        super().__init__(f"{name} (xela_server {address})")
        self._address = _split(address)
        self._sensor = sensor
        self._early: list[str] = []  # texts that came with the handshake
        self._number: int | None = None

    def _connect(self, undo: ExitStack) -> None:
        """Connect; raises LostSensorError or ProtocolError."""
        self._early = []
        self._number = None
        self._messages = XelaMessages(*self._address, self.name)
        try:
            self._socket = undo.enter_context(socket.create_connection(self._address, CONNECT_S))
        except OSError as error:
            do = "Is the server running, and at this address (not only on its LAN address)?"
            raise faults.LostSensorError(expected(self.name, "a server", error, do)) from error
        undo.callback(self._leave)
        self._send()
        deadline_s = time.monotonic() + CONNECT_S
        while self._messages.protocol.state is State.CONNECTING:
            if time.monotonic() > deadline_s:
                raise faults.ProtocolError(
                    expected(self.name, "a WebSocket handshake", "none in time", IS_IT)
                )
            self._early += self._receive(CONNECT_S)[0]

    def _leave(self) -> None:
        if self._messages.protocol.state is State.OPEN:
            self._messages.protocol.send_close(1000)
        with suppress(faults.LostSensorError):  # the other side went first
            self._send()

    def read(self) -> list[Stamped]:
        """Return the scans that came, all of them, stamped when they were read."""
        texts = self._early
        self._early = []
        more_waits = True
        while more_waits and self._messages.protocol.state is State.OPEN:
            came, size = self._receive(0.0 if texts else READ_S)
            texts += came
            more_waits = self._must_read_on(size >= CHUNK_BYTES)
        if self._messages.protocol.state is not State.OPEN and not texts:
            raise self._gone("a close frame")  # what came with it was delivered before
        stamp_ns = now_ns()
        stamped = []
        for text in texts:
            scan = self._scan(text)
            if scan is not None:
                stamped.append(Stamped(stamp_ns, scan))
        return stamped

    def _receive(self, timeout_s: float) -> tuple[list[str], int]:
        """Return the texts that came in time, and their number of bytes; answer pings."""
        try:
            self._socket.settimeout(max(timeout_s, 1e-3))
            chunk = self._socket.recv(CHUNK_BYTES)
        except TimeoutError:
            return [], 0
        except OSError as error:
            raise self._gone(error) from error
        texts = self._messages.feed(chunk)
        if not chunk:
            raise self._gone("the end of the connection")
        self._send()
        return texts, len(chunk)

    def _send(self) -> None:
        try:
            self._socket.settimeout(CONNECT_S)
            self._socket.sendall(b"".join(self._messages.protocol.data_to_send()))
        except OSError as error:
            raise self._gone(error) from error

    def _gone(self, came: object) -> faults.LostSensorError:
        do = "Is the server still running? Connecting again."
        return faults.LostSensorError(expected(self.name, "an open connection", came, do))

    def _scan(self, text: str) -> np.ndarray | None:
        try:
            number, scan = read_message(text, self._sensor, self.name)
        except faults.ProtocolError:
            # one garbled message; if none makes sense, the reader finds the sensor stale
            self.counts.bad += 1
            return None
        if scan is None or (number is not None and number == self._number):
            return None  # a greeting, or the same scan again
        if number is not None and self._number is not None:
            self.counts.lost += max(number - self._number - 1, 0)
        self._number = number
        self.counts.samples += 1
        return scan


def read_message(text: str, sensor: str, name: str) -> tuple[int | None, np.ndarray | None]:
    """Return a message's running number, if any, and ``sensor``'s (16, 3) uint16 counts.

    A greeting, or anything else without data, gives (None, None). Errors call the sensor ``name``.

    Raises ProtocolError: no JSON object, or words that are no counts; WrongSensorError: no such
    sensor, or not 16 taxels; SimulatedSensorError: the server says that its bus is simulated.
    """
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise faults.ProtocolError(expected(name, "JSON", error, IS_IT)) from error
    if not isinstance(message, dict):
        raise faults.ProtocolError(expected(name, "a JSON object", type(message).__name__, IS_IT))
    _refuse_simulation(message, name)
    if message.get("type") != "routine":
        return None, None
    entry = message.get(sensor)
    if not isinstance(entry, dict):
        there = sorted(
            key for key, value in message.items() if key.isdigit() and isinstance(value, dict)
        )
        raise faults.WrongSensorError(
            expected(name, f"sensor {sensor}", there, "Set server_sensor to one of them.")
        )
    number = message.get("message")
    if type(number) is not int:
        number = None
    return number, _counts(entry.get("data"), f"{name}, data")


def _refuse_simulation(message: dict[str, Any], name: str) -> None:
    """Raise if a bus field, at the top or one level down, says "sim": invented data looks alive."""
    nested = [value for value in message.values() if isinstance(value, dict)]
    for part in (message, *nested):
        for field in _BUS_FIELDS:
            bus = part.get(field)
            if isinstance(bus, str) and bus.strip().lower() == "sim":
                do = "Set bustype in xServ.ini to the real adapter and restart xela_server."
                raise faults.SimulatedSensorError(
                    expected(f"{name}, bustype", "a real bus", "sim", do)
                )


def _counts(data: object, what: str) -> np.ndarray:
    words = data.split(",") if isinstance(data, str) else data
    if not isinstance(words, list):
        raise faults.ProtocolError(
            expected(what, "48 words", type(data).__name__, "Is the sensor running?")
        )
    if len(words) != WORDS:
        raise faults.WrongSensorError(
            expected(what, f"{WORDS} words", len(words), "Is it a 4×4 patch?")
        )
    return np.array([_word(word, what) for word in words], np.uint16).reshape(TAXEL_SHAPE)


def _word(word: object, what: str) -> int:
    if isinstance(word, str) and _HEX.fullmatch(word):
        return int(word, 16)
    if type(word) is int and 0 <= word <= FULL_SCALE:
        return word
    wanted = f"hex words or 0 … {FULL_SCALE}"
    raise faults.ProtocolError(expected(what, wanted, repr(word)[:40], "Is this the raw stream?"))


def _split(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix("ws://").rstrip("/").partition(":")
    if not host or (port and not (port.isascii() and port.isdigit() and 0 < int(port) <= 65_535)):
        raise ContractError(
            expected("xela_server", "host or host:port", address, f"E.g. 192.168.0.5:{PORT}.")
        )
    return host, int(port or PORT)
