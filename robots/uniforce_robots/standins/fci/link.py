"""One device's sockets: a TCP listener, its one client, a UDP socket for states; the journal."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from enum import IntEnum
from pathlib import Path
from typing import TextIO

from uniforce_robots.standins.fci import protocol as p

DATAGRAM_BYTES = 65536
UNREAD_s = 1.0  # how long an answer may wait for its client to read


class Journal:
    """A log of the wire, a JSON object per line, flushed at once; ``time_s``: CLOCK_MONOTONIC."""

    def __init__(self, path: Path | None) -> None:
        self._file: TextIO | None = path.open("w", buffering=1) if path else None

    @property
    def is_on(self) -> bool:
        """Whether there is a file; spares the 1 kHz loop the work of describing."""
        return self._file is not None

    def write(self, what: str, **details: object) -> None:
        """Add a line."""
        if self._file is not None:
            self._file.write(
                json.dumps({"time_s": time.monotonic(), "what": what, **details}) + "\n"
            )


def read_journal(path: Path, begin: int = 0) -> list[dict]:
    """Return a journal's whole lines from a byte on; a killed process may leave half a line."""
    text = path.read_bytes()[begin:].decode()
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


class Link:
    """Sockets of one device. FCI takes one client at a time: a second one is turned away."""

    def __init__(self, address: str, port: int, header: p.Header, journal: Journal) -> None:
        self.header = header
        self.journal = journal
        self.listener = socket.create_server((address, port), backlog=4)
        self.listener.setblocking(False)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind((address, 0))
        self.udp.setblocking(False)
        self.client: socket.socket | None = None
        self.states_to: tuple[str, int] | None = None
        self._host = ""
        self._buffer = b""

    def write(self, what: str, **details: object) -> None:
        """Add a line about this device to the journal."""
        self.journal.write(what, device=self.header.device, **details)

    def write_request(self, message: p.Message, commands: type[IntEnum], **details: object) -> None:
        """Add a request to the journal; ``commands`` names it."""
        name = commands(message.command).name if message.command in list(commands) else "?"
        size = self.header.layout.size + len(message.payload)
        self.write("request", command=name, command_id=message.command_id, bytes=size, **details)

    def sockets(self) -> list[socket.socket]:
        """Return what to wait on."""
        found = [self.listener, self.udp]
        if self.client is not None:
            found.append(self.client)
        return found

    def accept(self) -> bool:
        """Take a client, or turn it away while there is one; return whether it replaces one."""
        connection, peer = self.listener.accept()
        replaces = self._client_left()
        if replaces:
            self.drop("gone")
        if self.client is not None:
            self.write("turned away", peer=peer)
            connection.close()
            return False
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        self.client = connection
        self._host = peer[0]
        self._buffer = b""
        self.write("client", peer=peer)
        return replaces

    def _client_left(self) -> bool:
        """Return whether the client has hung up and its socket was not read since."""
        if self.client is None:
            return False
        try:
            return not self.client.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except ConnectionError:
            return True

    def receive(self) -> Iterator[p.Message]:
        """Yield the whole requests that arrived; drop a client that is gone or sends garbage."""
        try:
            data = self.client.recv(DATAGRAM_BYTES) if self.client else b""
        except ConnectionError:
            data = b""
        if not data:
            self.drop("gone")
        self._buffer += data
        while self.client is not None:
            try:
                message, self._buffer = self.header.decode(self._buffer)
            except p.ProtocolError as error:
                self.drop(str(error))
                return
            if message is None:
                return
            yield message

    def drop(self, why: str) -> None:
        """Close the connection to the client."""
        if self.client is not None:
            self.client.close()
            self.write("dropped", why=why)
        self.client = None
        self.states_to = None

    def greet(self, message: p.Message, version: int, reply: Callable[[int, int], bytes]) -> None:
        """Answer Connect by status and version, and send states from now on if the version fits.

        Raises ProtocolError: no Connect.
        """
        wanted, udp_port = p.unpack(p.CONNECT, message.payload, "Connect")
        fits = wanted == version
        status = p.ConnectStatus.SUCCESS if fits else p.ConnectStatus.INCOMPATIBLE_VERSION
        self.reply(message, reply(status, version))
        if fits and self.client is not None:
            self.states_to = (self._host, udp_port)  # not getpeername(): it may have left again

    def reply(self, to: p.Message, payload: bytes) -> None:
        """Answer a request."""
        size = self.header.layout.size + len(payload)
        status = payload[0] if payload else None
        self.write("reply", command=to.command, command_id=to.command_id, status=status, bytes=size)
        self.send_bytes(self.header.encode(p.Message(to.command, to.command_id, payload)))

    def send_bytes(self, data: bytes) -> None:
        """Send bytes as they are; drop a client that has left or doesn't read."""
        if self.client is None:
            return
        try:
            self.client.settimeout(UNREAD_s)  # the model is larger than a socket buffer may be
            self.client.sendall(data)
            self.client.setblocking(False)
        except (ConnectionError, TimeoutError):
            self.drop("gone")

    def send_state(self, datagram: bytes) -> None:
        """Send a state to the client, if there is one."""
        if self.states_to is None:
            return
        try:
            self.udp.sendto(datagram, self.states_to)
        except (ConnectionError, BlockingIOError):  # its socket is closed; TCP will show it
            return

    def datagrams(self) -> Iterator[bytes]:
        """Yield the datagrams that have arrived."""
        while True:
            try:
                yield self.udp.recv(DATAGRAM_BYTES)
            except (BlockingIOError, ConnectionError):
                return
