"""uSkin through the maker's xela_server: several programs may listen, at whatever rate the server chooses.

It binds its LAN address only (1.7.6) and is delivered with a simulated bus, whose data looks alive; it is refused where
the server says so, but not every version does: look into xServ.ini.  Never run against the real server.
"""

from __future__ import annotations

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.samples import now_ns
from uniforce_robots.sensors.sources import SourceCounts, Stamped
from uniforce_robots.sensors.websocket import WebSocket
from uniforce_robots.sensors.xela_message import read_message
from uniforce_vtla.errors import ContractError, expected

READ_S = 0.05
PORT = 5000  # xela_server's default


class ServerUSkin:
    """A ``USkinSource`` behind xela_server.

    Args:
        address: ``host`` or ``host:port``.
        sensor: which sensor of the server's message.
        name: how errors call it.

    Raises:
        ContractError: no such form of address.
    """

    def __init__(self, address: str, sensor: str = "1", name: str = "uskin") -> None:
        self.name = f"{name} (xela_server {address})"
        self._host, self._port = _split(address)
        self._sensor = sensor
        self._socket: WebSocket | None = None
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
        self._socket = WebSocket(self._host, self._port, self.name)

    def read(self) -> list[Stamped]:
        """Return the scans that came.

        Raises:
            LostSensorError: the server went away.
            ProtocolError: broken frames.
            WrongSensorError: no such sensor, or not 16 taxels.
            SimulatedSensorError: the server says that its bus is simulated.
        """
        if self._socket is None:
            raise LostSensorError(expected(self.name, "a connection", "none", "Call open()."))
        texts = self._socket.receive(READ_S)
        stamp_ns = now_ns()
        scans = [self._scan(text, stamp_ns) for text in texts]
        return [scan for scan in scans if scan is not None]

    def close(self) -> None:
        """Leave the server."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

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
        raise ContractError(
            expected("xela_server", "host or host:port", address, f"E.g. 192.168.0.5:{PORT}.")
        )
    return host, int(port) if port else PORT
