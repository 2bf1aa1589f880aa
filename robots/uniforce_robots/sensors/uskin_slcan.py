"""uSkin through a USB-CAN adapter that speaks SLCAN, with pyserial alone: no root, no SocketCAN, no vendor server.

The maker's recipe is ``slcand -o -s8 -t hw -S 3000000``: 3 Mbaud, 1 Mbit/s on the bus.  The patch streams by itself
after power-up; its rate is measured, never assumed.  Never run on hardware: proven against a pseudo-terminal.
"""

from __future__ import annotations

import contextlib
import termios
import time

import serial

from uniforce_robots.sensors.backlog import MAX_BEHIND_S, Backlog
from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.samples import now_ns
from uniforce_robots.sensors.slcan_lines import SlcanScans, uspa44_ids
from uniforce_robots.sensors.sources import SourceCounts, Stamped
from uniforce_vtla.errors import expected

BAUD = 3_000_000
READ_TIMEOUT_S = 0.05
FULL_BYTES = 4000  # a tty hands out 4,095 bytes at most: more is waiting
ANSWER_S = 0.5  # an adapter acknowledges within milliseconds
OPENING = (b"C", b"S8", b"Z0", b"O")  # close what was open, 1 Mbit/s, no adapter time stamps, open
_BROKEN = (
    OSError,
    termios.error,
)  # pyserial's SerialException is an OSError; a vanished tty raises termios.error


class SlcanUSkin:
    """A ``USkinSource`` on a serial port.

    Args:
        port: e.g. ``/dev/serial/by-id/usb-…``.
        ids: CAN id of each taxel; None for those of a 4×4 patch.
        name: how errors call the sensor.
        controller: the patch's microcontroller id; unused where ``ids`` are given.
        max_behind_s: how long reading may lag behind before that is an error.
    """

    def __init__(
        self,
        port: str,
        ids: tuple[int, ...] | None = None,
        name: str = "uskin",
        controller: int = 0,
        max_behind_s: float = MAX_BEHIND_S,
    ) -> None:
        self.name = f"{name} ({port})"
        self.port = port
        self.scans = SlcanScans(uspa44_ids(controller) if ids is None else ids)
        self._backlog = Backlog(self.name, FULL_BYTES, max_behind_s)
        self._serial: serial.Serial | None = None

    @property
    def counts(self) -> SourceCounts:
        """Scans delivered, broken scans, bad lines."""
        return self.scans.counts

    def open(self) -> None:
        """Open the port for ourselves and start the channel.

        Raises:
            LostSensorError: no such port, or it is in use.
            ProtocolError: whatever is there doesn't answer like an SLCAN adapter.
        """
        self.scans.forget()
        do = "Check cable and permissions (group dialout), and that xela_server or slcand doesn't hold it."
        try:
            self._serial = serial.Serial(
                self.port, BAUD, timeout=READ_TIMEOUT_S, write_timeout=ANSWER_S, exclusive=True
            )
            self._serial.reset_input_buffer()
            for command in OPENING:
                self._command(self._serial, command)
        except (*_BROKEN, ValueError) as error:
            self.close()
            raise LostSensorError(expected(self.name, "a serial port", error, do)) from error
        except ProtocolError:
            self.close()
            raise

    def read(self) -> list[Stamped]:
        """Return the scans that came, stamped when they were read.

        Raises:
            LostSensorError: the adapter is gone.
            StaleSensorError: they come faster than they are read, so that their stamps would be wrong.
        """
        port = self._serial
        if port is None:
            raise LostSensorError(expected(self.name, "an open port", "closed", "Call open()."))
        scans = self.scans.feed(chunk := self._receive(port))
        while self._backlog.more_waits(len(chunk)):
            scans += self.scans.feed(chunk := self._receive(port))
        stamp_ns = now_ns()
        return [Stamped(stamp_ns, scan) for scan in scans]

    def close(self) -> None:
        """Close channel and port."""
        port, self._serial = self._serial, None
        if port is None:
            return
        try:
            port.write(b"C\r")
        except _BROKEN:
            pass  # unplugged: nothing left to tell it
        finally:
            _close_port(port)

    def _receive(self, port: serial.Serial) -> bytes:
        try:
            return port.read(max(1, port.in_waiting))
        except (*_BROKEN, TypeError) as error:  # TypeError: pyserial's descriptor vanished while it read
            do = "Was it unplugged? It is reopened once it is back."
            raise LostSensorError(expected(self.name, "a readable port", error, do)) from error

    def _command(self, port: serial.Serial, command: bytes) -> None:
        """Send one command and wait for its acknowledgement; data lines of an open channel are skipped."""
        port.write(command + b"\r")
        deadline, tail = time.monotonic() + ANSWER_S, b""
        while time.monotonic() < deadline:
            came = port.read(max(1, port.in_waiting))
            if b"\x07" in came:
                if command == b"C":  # it was closed already
                    return
                raise self._refused(command, "BEL (refused)")
            *lines, tail = (tail + came).split(b"\r")
            if b"" in lines:
                return
            tail = tail[-64:]
        raise self._refused(command, "no answer")

    def _refused(self, command: bytes, came: str) -> ProtocolError:
        do = "Is this the SLCAN adapter, at 3 Mbaud?"
        return ProtocolError(
            expected(f"{self.name}, command {command.decode()}", "an acknowledgement", came, do)
        )


def _close_port(port: serial.Serial) -> None:
    with contextlib.suppress(*_BROKEN):  # the device is gone; its descriptor is released anyway
        port.close()
