"""A server on loopback that never blocks: its listener, its clients, and what each is still to be sent."""

from __future__ import annotations

import socket

LOOPBACK = "127.0.0.1"
RECEIVE_BYTES = 4096


class LoopbackServer:
    """Sends the same bytes to everybody; a client that doesn't read loses whole messages, never parts of one.

    Args:
        port: 0 = any free one.
        out_bytes: what may wait per client.

    Attributes:
        address: (host, port), the same after ``unplug`` and ``plug``.
        visitors: connected, not yet admitted (a handshake isn't finished), and what they sent so far.
        clients: admitted, and what waits to be sent to them.
    """

    def __init__(self, port: int, out_bytes: int) -> None:
        self.address: tuple[str, int] = (LOOPBACK, port)
        self.visitors: dict[socket.socket, bytes] = {}
        self.clients: dict[socket.socket, bytearray] = {}
        self._out_bytes = out_bytes
        self._sent = self._dropped = 0
        self._listener: socket.socket | None = None
        self.plug()

    def plug(self) -> None:
        """Accept visitors from now on."""
        if self._listener is None:
            self._listener = socket.create_server(self.address)  # sets SO_REUSEADDR: the same port again
            self.address = self._listener.getsockname()[:2]

    def unplug(self) -> None:
        """Close every connection and stop listening."""
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

    def receive(self, ready: list[socket.socket]) -> None:
        """Accept a new visitor, take what visitors sent, part from who went; what clients send is dropped."""
        for one in ready:
            if one is self._listener:
                visitor, _ = self._listener.accept()
                visitor.setblocking(False)
                visitor.setsockopt(
                    socket.IPPROTO_TCP, socket.TCP_NODELAY, 1
                )  # or 40 ms wait for an acknowledgement
                self.visitors[visitor] = b""
            elif one in self.visitors or one in self.clients:  # not parted from since it was ready
                self._receive(one)

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
        """Close the connection to one."""
        self.clients.pop(client, None)
        self.visitors.pop(client, None)
        client.close()

    def stats(self) -> str:
        """Return the counts as a stand-in prints them."""
        return f"sent={self._sent} dropped={self._dropped} clients={len(self.clients)}"

    def _receive(self, client: socket.socket) -> None:
        try:
            chunk = client.recv(RECEIVE_BYTES)
        except OSError:
            chunk = b""
        if not chunk:
            self.part_from(client)
        elif client in self.visitors:
            self.visitors[client] = (self.visitors[client] + chunk)[-2 * RECEIVE_BYTES :]

    def _flush(self, client: socket.socket) -> None:
        out = self.clients[client]
        try:
            del out[: client.send(out)]
        except BlockingIOError:
            return
        except OSError:
            self.part_from(client)
