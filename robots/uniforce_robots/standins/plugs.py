"""How a stand-in is reached: by a pseudo-terminal or by sockets.  Neither ever blocks.

Both can be unplugged and put back, and count messages ``sent``; unread ones are dropped whole.
"""

import contextlib
import os
import socket
import tempfile
import termios
import tty
from collections.abc import Callable
from typing import Any

READ_BYTES = 4096
WELCOME_S = 1.0  # a client that asks for nothing so long is let go
QUEUE = 200  # messages that wait for a client that doesn't read, as behind a real streamer
TTY_BYTES = 65_536  # what a tty's own buffers hold before data is lost


class PseudoTerminal:
    """A pseudo serial port behind a link of fixed name; it sends in ``pieces`` of so many bytes."""

    def __init__(self, name: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix=f"uniforce-{name}-")
        self.address = f"{self._folder.name}/port"
        self.pieces = READ_BYTES
        self.sent = 0
        self.out = bytearray()
        self._ends: list[int] = []  # ours and the client's; none while unplugged
        self.plug()

    def plug(self) -> None:
        """Put it in; does nothing when it is."""
        if not self._ends:
            self._ends = list(os.openpty())
            tty.setraw(self._ends[1], termios.TCSANOW)
            os.set_blocking(self._ends[0], False)
            os.symlink(os.ttyname(self._ends[1]), self.address)

    def unplug(self) -> None:
        """Pull it out; does nothing when it is out."""
        if self._ends:
            os.unlink(self.address)
        while self._ends:
            os.close(self._ends.pop())
        self.out.clear()

    def waits_for(self) -> tuple[list[Any], list[Any]]:
        """Return what to select on, for input and for room."""
        return self._ends[:1], self._ends[:1] if self.out else []

    def receive(self, ready: list[Any]) -> bytes:
        """Return what was written to the port."""
        if self._ends and self._ends[0] in ready:
            return os.read(self._ends[0], READ_BYTES)
        return b""

    def send(self, message: bytes) -> None:
        """Keep a message for ``flush``."""
        if len(self.out) + len(message) <= TTY_BYTES:
            self.sent += 1
            self.out += message

    def flush(self) -> None:
        """Write what is kept, as far as there is room."""
        with contextlib.suppress(BlockingIOError):
            while self.out:
                del self.out[: os.write(self._ends[0], self.out[: self.pieces])]


class Sockets:
    """A listener whose clients are all sent the same; ``welcome``: a new client → its first bytes.

    ``where`` is (host, port), 0 for any free port; or a path, for packets: one read is one message,
    as with hidraw.
    """

    def __init__(
        self, where: tuple[str, int] | str, welcome: Callable[[socket.socket], bytes]
    ) -> None:
        self.where = where
        self._welcome = welcome
        self.sent = 0
        self.clients: dict[socket.socket, list[bytes]] = {}  # and what waits to be sent to them
        self._listener: socket.socket | None = None
        self.plug()

    def plug(self) -> None:
        """Listen; does nothing when it does."""
        if self._listener is not None:
            return
        if isinstance(self.where, str):
            self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._listener.bind(self.where)
            self._listener.listen(1)
        else:
            # sets SO_REUSEADDR: the same port again
            self._listener = socket.create_server(self.where)
            # clients inherit it; without, 40 ms wait for an acknowledgement
            self._listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.where = self._listener.getsockname()

    def unplug(self) -> None:
        """Close every connection and stop listening; does nothing when it doesn't."""
        for one in self.waits_for()[0]:
            self._part_from(one)
        if isinstance(self.where, str) and self._listener is not None:
            os.unlink(self.where)
        self._listener = None

    def waits_for(self) -> tuple[list[Any], list[Any]]:
        """Return what to select on, for input and for room."""
        listening = [self._listener] if self._listener else []
        return [*listening, *self.clients], [client for client, out in self.clients.items() if out]

    def receive(self, ready: list[Any]) -> bytes:
        """Accept clients and part from them; nothing of what they send is for the stand-in."""
        for one in ready:
            client = self._listener.accept()[0] if self._listener and one is self._listener else one
            try:
                if client is not one:
                    client.settimeout(WELCOME_S)
                    self.clients[client] = [self._welcome(client)]
                    client.setblocking(False)
                elif one in self.clients and not one.recv(READ_BYTES):
                    self._part_from(one)
            except OSError:
                self._part_from(client)
        return b""

    def send(self, message: bytes) -> None:
        """Keep a message for every client."""
        for out in self.clients.values():
            if len(out) < QUEUE:
                self.sent += 1
                out.append(message)

    def flush(self) -> None:
        """Send what sockets take without blocking."""
        for client in self.waits_for()[1]:
            out = self.clients[client]
            try:
                while out:
                    if out[0]:
                        out[0] = out[0][client.send(out[0]) :]
                    del out[: not out[0]]
            except BlockingIOError:
                continue
            except OSError:
                self._part_from(client)

    def _part_from(self, client: socket.socket) -> None:
        self.clients.pop(client, None)
        client.close()
