"""A server on loopback that never blocks: its listener, its clients, and what each is still to be sent."""

from __future__ import annotations

import socket

LOOPBACK = "127.0.0.1"
HEAR_BYTES = 4096


class LoopbackServer:
    """Sends the same bytes to everybody; a client that doesn't read loses whole messages, never parts of one.

    Args:
        port: 0 = any free one.
        out_bytes: what may wait per client.

    Attributes:
        address: (host, port), the same after ``unplug`` and ``listen``.
        visitors: connected, not yet admitted (a handshake isn't finished), and what they said so far.
        clients: admitted, and what waits to be sent to them.
    """

    def __init__(self, port: int, out_bytes: int) -> None:
        self.address: tuple[str, int] = (LOOPBACK, port)
        self.visitors: dict[socket.socket, bytes] = {}
        self.clients: dict[socket.socket, bytearray] = {}
        self._out_bytes = out_bytes
        self._sent = self._dropped = 0
        self._listener: socket.socket | None = None
        self.listen()

    def listen(self) -> None:
        """Accept visitors from now on."""
        if self._listener is None:
            self._listener = socket.create_server(self.address)  # sets SO_REUSEADDR: the same port again
            self.address = self._listener.getsockname()[:2]

    def unplug(self) -> None:
        """Hang up on everybody and stop listening."""
        for client in [*self.clients, *self.visitors]:
            self.part_from(client)
        if self._listener is not None:
            self._listener.close()
        self._listener = None

    def reading(self) -> list[socket.socket]:
        """Return the sockets to wait for input on."""
        listening = [self._listener] if self._listener is not None else []
        return [*listening, *self.visitors, *self.clients]

    def writing(self) -> list[socket.socket]:
        """Return the clients to whom something waits to be sent."""
        return [client for client, out in self.clients.items() if out]

    def hear(self, ready: object) -> bytes:
        """Take what a ready socket says: a new visitor, a goodbye, or bytes, which are returned."""
        if not isinstance(ready, socket.socket):
            return b""
        if ready is self._listener:
            visitor, _ = self._listener.accept()
            visitor.setblocking(False)
            self.visitors[visitor] = b""
            return b""
        if ready not in self.clients and ready not in self.visitors:
            return b""  # parted from since it was ready
        return self._receive(ready)

    def admit(self, visitor: socket.socket, welcome: bytes) -> None:
        """Make a visitor a client whose first bytes are ``welcome``."""
        del self.visitors[visitor]
        self.clients[visitor] = bytearray(welcome)

    def broadcast(self, message: bytes) -> None:
        """Queue a message for every client, whole or not at all."""
        for out in self.clients.values():
            if len(out) + len(message) > self._out_bytes:
                self._dropped += 1
            else:
                self._sent += 1
                out += message

    def flush(self, writable: list[socket.socket]) -> None:
        """Send what a socket takes without blocking."""
        for client in writable:
            if client in self.clients:
                self._flush(client)

    def part_from(self, client: socket.socket) -> None:
        """Hang up on one."""
        self.clients.pop(client, None)
        self.visitors.pop(client, None)
        client.close()

    def stats(self) -> str:
        """Return the counts as ``Control`` prints them."""
        return f"sent={self._sent} dropped={self._dropped} clients={len(self.clients)}"

    def _receive(self, client: socket.socket) -> bytes:
        try:
            heard = client.recv(HEAR_BYTES)
        except OSError:
            heard = b""
        if not heard:
            self.part_from(client)
        return heard

    def _flush(self, client: socket.socket) -> None:
        out = self.clients[client]
        try:
            del out[: client.send(out)]
        except BlockingIOError:
            return
        except OSError:
            self.part_from(client)
