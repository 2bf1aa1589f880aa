r"""uSkin through a USB-CAN adapter that speaks SLCAN, with pyserial alone: no root, no SocketCAN, no vendor server.

The maker's recipe is ``slcand -o -s8 -t hw -S 3000000``: 3 Mbaud, 1 Mbit/s on the bus.  The patch streams by itself
after power-up; its rate is measured, never assumed.  Never run on hardware: proven against a pseudo-terminal.

A frame is ``tIIILDD…\r``: 11-bit id, length 8, eight bytes in hex, four more digits when the adapter stamps time.  The
eight bytes are unused, X, Y, Z (big-endian uint16), unused.  Sources: Lawicel CANUSB manual; XELA uSPa manual, 2023.

Not ``python-can``: it reads byte by byte (1,860 µs of CPU per scan against 130, 400 of 500 Hz), takes a mute or
refusing adapter for an open one, ends at the first garbage, and is LGPL.
"""

from __future__ import annotations

import contextlib
import re
import termios
import time

import numpy as np
import serial

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import MAX_BEHIND_S, Backlog
from uniforce_robots.sensors.samples import SourceCounts, Stamped, now_ns
from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import ContractError, expected

BAUD = 3_000_000
READ_TIMEOUT_S = 0.05
FULL_BYTES = 4000  # a tty hands out 4,095 bytes at most: more is waiting
ANSWER_S = 0.5  # an adapter acknowledges within milliseconds
OPENING = (b"C", b"S8", b"Z0", b"O")  # close what was open, 1 Mbit/s, no adapter time stamps, open
MAX_TAIL_BYTES = 64  # the longest legal line has 32; more without an end is noise
_BELL = b"\x07"  # the adapter's "error"
_FRAME = re.compile(rb"t([0-9A-Fa-f]{3})8([0-9A-Fa-f]{16})(?:[0-9A-Fa-f]{4})?")
_OTHER = re.compile(  # replies, other traffic
    rb"|[zZ]|[VNF][0-9A-Za-z]*|t[0-9A-Fa-f]{3}[0-7].*|[TrR][0-9A-Fa-f]+"
)
_TAXELS = TAXEL_SHAPE[0]
_ALL_SEEN = (1 << _TAXELS) - 1
# pyserial's SerialException is an OSError; a vanished tty raises termios.error
_BROKEN = (OSError, termios.error)


def uspa44_ids(controller: int = 0) -> tuple[int, ...]:
    """Return the CAN ids of a 4×4 patch, taxel by taxel: row in bits 10-8, column in 7-4, controller in 3-0.

    Which way rows and columns run on the finger wasn't seen on hardware: run ``uniforce touch check=orientation``.

    Raises:
        ContractError: a controller outside 0 … 15.
    """
    if not 0 <= controller <= 15:
        raise ContractError(expected("controller", "0 … 15", controller, "Read it off `candump`."))
    return tuple(row << 8 | column << 4 | controller for row in range(4) for column in range(4))


class SlcanScans:
    """SLCAN text → scans of 16 taxels; no I/O.

    A scan begins with the first id of the map and is delivered once all 16 were seen.  One that repeats a taxel or
    begins anew before it is whole is dropped and counted, up to the next beginning: taxels of two scans never mix.

    Args:
        ids: CAN id of each taxel, in the order of the rows delivered.

    Raises:
        ContractError: not 16 different 11-bit ids.
    """

    def __init__(self, ids: tuple[int, ...]) -> None:
        if len(ids) != _TAXELS or len(set(ids)) != _TAXELS or not all(0 <= i < 0x800 for i in ids):
            do = "Give one 11-bit id per taxel."
            raise ContractError(expected("id map", f"{_TAXELS} different ids", f"{len(ids)}: {ids}", do))
        self._taxel_of = {can_id: taxel for taxel, can_id in enumerate(ids)}
        self._scan = np.zeros(TAXEL_SHAPE, np.uint16)
        self._seen = 0  # one bit per taxel; 0 = waiting for a beginning
        self._tail = b""
        self._scans = self._lost = self._bad = 0

    @property
    def counts(self) -> SourceCounts:
        """Scans delivered, scans broken, lines that made no sense."""
        return SourceCounts(self._scans, self._lost, self._bad)

    def forget(self) -> None:
        """Drop what is half read, as after reopening the port."""
        self._tail, self._seen = b"", 0

    def feed(self, chunk: bytes) -> list[np.ndarray]:
        """Return the scans, (16, 3) uint16 each, that ``chunk`` completes."""
        *lines, tail = (self._tail + chunk.replace(_BELL, b"")).split(b"\r")
        if len(tail) > MAX_TAIL_BYTES:
            self._bad, tail = self._bad + 1, b""
        self._tail = tail
        scans = [self._frame(line) for line in lines]
        return [scan for scan in scans if scan is not None]

    def _frame(self, line: bytes) -> np.ndarray | None:
        match = _FRAME.fullmatch(line)
        if match is None:
            self._bad += len(line) > MAX_TAIL_BYTES or _OTHER.fullmatch(line) is None
            return None
        taxel = self._taxel_of.get(int(match[1], 16))
        return None if taxel is None else self._place(taxel, int(match[2][2:14], 16))

    def _place(self, taxel: int, word: int) -> np.ndarray | None:
        if self._seen >> taxel & 1:  # repeated, or the next scan began before this one was whole
            self._lost, self._seen = self._lost + 1, 0
        if self._seen == 0 and taxel != 0:
            return None
        self._seen |= 1 << taxel
        self._scan[taxel] = word >> 32, word >> 16 & 0xFFFF, word & 0xFFFF
        if self._seen != _ALL_SEEN:
            return None
        self._scans, self._seen = self._scans + 1, 0
        return self._scan.copy()


class SlcanUSkin:
    """Whole scans, (16, 3) uint16 raw counts each, from a serial port.

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
        self._port = port
        self._scans = SlcanScans(uspa44_ids(controller) if ids is None else ids)
        self._backlog = Backlog(self.name, FULL_BYTES, max_behind_s)
        self._serial: serial.Serial | None = None

    @property
    def counts(self) -> SourceCounts:
        """Scans delivered, broken scans, bad lines."""
        return self._scans.counts

    def open(self) -> None:
        """Open the port for ourselves and start the channel.

        Raises:
            LostSensorError: no such port, or it is in use.
            ProtocolError: whatever is there doesn't answer like an SLCAN adapter.
        """
        self._scans.forget()
        do = "Check cable and permissions (group dialout), and that xela_server or slcand doesn't hold it."
        try:
            self._serial = serial.Serial(
                self._port, BAUD, timeout=READ_TIMEOUT_S, write_timeout=ANSWER_S, exclusive=True
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
        scans = self._scans.feed(chunk := self._receive(port))
        while self._backlog.more_waits(len(chunk)):
            scans += self._scans.feed(chunk := self._receive(port))
        stamp_ns = now_ns()
        return [Stamped(stamp_ns, scan) for scan in scans]

    def close(self) -> None:
        """Close channel and port."""
        port, self._serial = self._serial, None
        if port is None:
            return
        with contextlib.suppress(*_BROKEN):  # unplugged: no channel left to close
            port.write(b"C\r")
        with contextlib.suppress(*_BROKEN):  # its descriptor is released anyway
            port.close()

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
            if _BELL in came:
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
        what = f"{self.name}, command {command.decode()}"
        return ProtocolError(expected(what, "an acknowledgement", came, do))
