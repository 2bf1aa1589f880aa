"""uSkin through the maker's xela_server: several programs may listen, at whatever rate the server chooses.

It binds its LAN address only (1.7.6) and is delivered with a simulated bus, whose data looks alive; it is refused where
the server says so, but not every version does: look into xServ.ini.  Never run against the real server.
"""

from __future__ import annotations

import contextlib
import socket
import time

from websockets.client import ClientProtocol
from websockets.frames import DATA_OPCODES, Frame
from websockets.protocol import State
from websockets.uri import parse_uri

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import Backlog
from uniforce_robots.sensors.samples import SourceCounts, Stamped, now_ns
from uniforce_robots.sensors.xela_message import read_message
from uniforce_vtla.errors import ContractError, expected

READ_S = 0.05
CONNECT_S = 2.0
PORT = 5000  # xela_server's default
CHUNK_BYTES = 1 << 16
MAX_MESSAGE_BYTES = 1 << 20  # a server message of 16 taxels has about 2 KB


class XelaMessages:
    """Server bytes → texts, by the protocol half of ``websockets``; no I/O.

    Its connection classes read in a thread of their own into a queue: a message that waited there would pass for new.

    Args:
        host, port: named in the handshake.
        name: how errors call the sensor.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        self._name = name
        self._parts: list[bytes] = []
        self.protocol = ClientProtocol(parse_uri(f"ws://{host}:{port}/"), max_size=MAX_MESSAGE_BYTES)
        self.protocol.send_request(self.protocol.connect())

    @property
    def is_over(self) -> bool:
        """Whether the server has closed the connection properly."""
        return self.protocol.state in (State.CLOSING, State.CLOSED)

    def feed(self, chunk: bytes) -> list[str]:
        """Return the texts that ``chunk`` completes; empty means the end of the stream.

        Raises:
            ProtocolError: no handshake, frames the RFC forbids, or text that isn't UTF-8.
        """
        self.protocol.receive_data(chunk) if chunk else self.protocol.receive_eof()
        error = self.protocol.handshake_exc or self.protocol.parser_exc
        if error is not None and not isinstance(error, EOFError):
            do = "Is this xela_server's port?"
            raise ProtocolError(expected(self._name, "a WebSocket server (RFC 6455)", error, do)) from error
        frames = [event for event in self.protocol.events_received() if isinstance(event, Frame)]
        texts = [self._assembled(frame) for frame in frames if frame.opcode in DATA_OPCODES]
        return [text for text in texts if text is not None]

    def _assembled(self, frame: Frame) -> str | None:
        if frame.data:  # endless empty fragments must not pile up
            self._parts.append(bytes(frame.data))
        if not frame.fin:
            return None
        whole, self._parts = b"".join(self._parts), []
        try:
            return whole.decode()
        except UnicodeDecodeError as error:
            raise ProtocolError(expected(self._name, "UTF-8 text", error, "Is this xela_server?")) from error


class ServerUSkin:
    """Whole scans, (16, 3) uint16 raw counts each, from xela_server.

    Args:
        address: ``host`` or ``host:port``.
        sensor: which sensor of the server's message.
        name: how errors call it.

    Raises:
        ContractError: no such form of address.
    """

    def __init__(self, address: str, sensor: str = "1", name: str = "uskin") -> None:
        self.name = f"{name} (xela_server {address})"
        self._address = _split(address)
        self._sensor = sensor
        self._socket: socket.socket | None = None
        self._messages = XelaMessages(*self._address, self.name)
        self._backlog = Backlog(self.name, CHUNK_BYTES)
        self._early: list[str] = []  # texts that came with the handshake
        self._number: int | None = None
        self._scans = self._lost = self._bad = 0

    @property
    def counts(self) -> SourceCounts:
        """Scans delivered, gaps in the server's numbering, messages that made no sense."""
        return SourceCounts(self._scans, self._lost, self._bad)

    def open(self) -> None:
        """Connect; raises LostSensorError or ProtocolError."""
        self.close()
        self._number = None
        self._messages = XelaMessages(*self._address, self.name)
        try:
            self._socket = socket.create_connection(self._address, CONNECT_S)
        except OSError as error:
            do = "Is the server running, and at this address (not only on its LAN address)?"
            raise LostSensorError(expected(self.name, "a server", error, do)) from error
        try:
            self._early = self._shake_hands(self._socket)
        except (LostSensorError, ProtocolError):
            self.close()
            raise

    def read(self) -> list[Stamped]:
        """Return the scans that came.

        Raises:
            LostSensorError: the server went away.
            ProtocolError: broken frames.
            StaleSensorError: messages come faster than they are read.
            WrongSensorError: no such sensor, or not 16 taxels.
            SimulatedSensorError: the server says that its bus is simulated.
        """
        if self._socket is None:
            raise LostSensorError(expected(self.name, "a connection", "none", "Call open()."))
        texts = self._texts(self._socket)
        stamp_ns = now_ns()
        scans = [self._scan(text, stamp_ns) for text in texts]
        return [scan for scan in scans if scan is not None]

    def close(self) -> None:
        """Leave the server."""
        connection, self._socket = self._socket, None
        if connection is None:
            return
        if self._messages.protocol.state is State.OPEN:
            self._messages.protocol.send_close(1000)
        with contextlib.suppress(LostSensorError):  # the other side went first
            self._send(connection)
        connection.close()

    # -- bytes ------------------------------------------------------------------------------------------

    def _shake_hands(self, connection: socket.socket) -> list[str]:
        self._send(connection)
        early, deadline_s = [], time.monotonic() + CONNECT_S
        while self._messages.protocol.state is State.CONNECTING:
            if time.monotonic() > deadline_s:
                do = "Is this xela_server's port?"
                raise ProtocolError(expected(self.name, "a WebSocket handshake", "none in time", do))
            early += self._receive(connection, CONNECT_S)[0]
        return early

    def _texts(self, connection: socket.socket) -> list[str]:
        """Return what came, all of it: what waits in the kernel must not look new when it is read later."""
        texts, self._early = self._early, []
        while not self._messages.is_over:
            came, size = self._receive(connection, 0.0 if texts else READ_S)
            texts += came
            if not self._backlog.more_waits(size):
                break
        if self._messages.is_over and not texts:  # what came with its close frame is still delivered
            raise self._gone("a close frame")
        return texts

    def _receive(self, connection: socket.socket, timeout_s: float) -> tuple[list[str], int]:
        """Return the texts of what came in time, and how many bytes that were; pings are answered."""
        try:
            connection.settimeout(max(timeout_s, 1e-3))
            chunk = connection.recv(CHUNK_BYTES)
        except TimeoutError:
            return [], 0
        except OSError as error:
            raise self._gone(error) from error
        texts = self._messages.feed(chunk)
        if not chunk:
            raise self._gone("the end of the connection")
        self._send(connection)
        return texts, len(chunk)

    def _send(self, connection: socket.socket) -> None:
        try:
            connection.settimeout(CONNECT_S)
            connection.sendall(b"".join(self._messages.protocol.data_to_send()))
        except OSError as error:
            raise self._gone(error) from error

    def _gone(self, came: object) -> LostSensorError:
        do = "Is the server still running? Connecting again."
        return LostSensorError(expected(self.name, "an open connection", came, do))

    # -- scans ------------------------------------------------------------------------------------------

    def _scan(self, text: str, stamp_ns: int) -> Stamped | None:
        try:
            scan = read_message(text, self._sensor, self.name)
        except ProtocolError:
            self._bad += 1  # one garbled message; if none makes sense, the reader finds the sensor stale
            return None
        if scan is None or (scan.number is not None and scan.number == self._number):
            return None  # a greeting, or the same scan again
        if scan.number is not None and self._number is not None:
            self._lost += max(scan.number - self._number - 1, 0)
        self._number = scan.number
        self._scans += 1
        return Stamped(stamp_ns, scan.counts)


def _split(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix("ws://").rstrip("/").partition(":")
    if not host or (port and not (port.isascii() and port.isdigit() and 0 < int(port) <= 65_535)):
        do = f"E.g. 192.168.0.5:{PORT}."
        raise ContractError(expected("xela_server", "host or host:port", address, do))
    return host, int(port) if port else PORT
