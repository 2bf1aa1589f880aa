"""One device's sockets: a TCP listener, its one client, and the UDP socket its states leave from."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

from uniforce_robots.standins.fci.journal import Journal
from uniforce_robots.standins.fci.protocol import ConnectRequest, Header, Message, ProtocolError

DATAGRAM_BYTES = 65536
UNREAD_s = 1.0  # how long an answer may wait for its client to read


class Link:
    """Sockets of one device. FCI takes one client at a time: a second one is turned away."""

    def __init__(self, address: str, port: int, header: Header, journal: Journal) -> None:
        self.header, self.journal = header, journal
        self.address = address
        self.listener = socket.create_server((address, port), backlog=4)
        self.listener.setblocking(False)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind((address, 0))
        self.udp.setblocking(False)
        self.client: socket.socket | None = None
        self.states_to: tuple[str, int] | None = None
        self.garbage: Callable[[], bytes] | None = None  # sent in place of every answer
        self._peer, self._buffer = "", b""

    def sockets(self) -> list[socket.socket]:
        """Return what to wait on."""
        return [self.listener, self.udp, *([self.client] if self.client else [])]

    def accept(self) -> bool:
        """Take a client, or turn it away while there is one; return whether it takes the place of one that left."""
        connection, peer = self.listener.accept()
        replaces = self._client_left()
        if replaces:
            self.drop("gone")
        if self.client is not None:
            self.journal.write("turned away", device=self.header.device, peer=peer)
            connection.close()
            return False
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setblocking(False)
        self.client, self._peer, self._buffer = connection, peer[0], b""
        self.journal.write("client", device=self.header.device, peer=peer)
        return replaces

    def _client_left(self) -> bool:
        """Return whether the client has hung up and nobody has looked yet."""
        if self.client is None:
            return False
        try:
            return not self.client.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except ConnectionError:
            return True

    def receive(self) -> Iterator[Message]:
        """Yield the whole requests that have arrived; drop a client that is gone or talks nonsense."""
        try:
            data = self.client.recv(DATAGRAM_BYTES) if self.client else b""
        except ConnectionError:
            data = b""
        if not data:
            self.drop("gone")
            return
        self._buffer += data
        while self.client is not None:
            try:
                message, self._buffer = self.header.decode(self._buffer)
            except ProtocolError as error:
                self.drop(str(error))
                return
            if message is None:
                return
            yield message

    def drop(self, why: str) -> None:
        """Close the connection to the client."""
        if self.client is not None:
            self.client.close()
            self.journal.write("dropped", device=self.header.device, why=why)
        self.client, self.states_to = None, None

    def greet(self, message: Message, request: ConnectRequest, reply: bytes, accepted: bool) -> None:
        """Answer Connect, and send states from now on if the version fits."""
        self.send(Message(message.command, message.command_id, reply))
        if accepted and self.client is not None:
            self.states_to = (self._peer, request.udp_port)  # not getpeername(): it may have left again

    def send(self, message: Message) -> None:
        """Send an answer."""
        self.journal.write(
            "reply",
            device=self.header.device,
            command=message.command,
            command_id=message.command_id,
            status=message.payload[0] if message.payload else None,
            bytes=self.header.layout.size + len(message.payload),
        )
        self.send_bytes(self.garbage() if self.garbage else self.header.encode(message))

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
        except (ConnectionError, BlockingIOError):  # nobody listens there any more; TCP will tell
            return

    def datagrams(self) -> Iterator[bytes]:
        """Yield the datagrams that have arrived."""
        while True:
            try:
                yield self.udp.recv(DATAGRAM_BYTES)
            except (BlockingIOError, ConnectionError):
                return

    def close(self) -> None:
        """Close every socket."""
        self.drop("closing")
        self.listener.close()
        self.udp.close()
