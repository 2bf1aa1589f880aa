r"""uSkin through a USB-CAN adapter that speaks SLCAN: pyserial alone, no root, no SocketCAN.

The maker's recipe is ``slcand -o -s8 -t hw -S 3000000``: 3 Mbaud, 1 Mbit/s on the bus. The patch
streams by itself after power-up; its rate is measured. Never run on hardware: tested against a
pseudo-terminal.

A frame is ``tIIILDD…\r``: 11-bit id, length 8, eight bytes in hex, four more digits when the
adapter stamps time. The eight bytes are unused, X, Y, Z (big-endian uint16), unused. Sources:
Lawicel CANUSB manual; XELA uSPa manual, 2023.

Not ``python-can``: it reads byte by byte (1,860 µs of CPU per scan against 130, 400 of 500 Hz),
takes a mute or refusing adapter for an open one, ends at the first garbage, and is LGPL.
"""

import contextlib
import re
import termios
import time

import numpy as np
import serial

from uniforce_robots.sensors.faults import LostSensorError, ProtocolError
from uniforce_robots.sensors.reader import SampleSource, SourceCounts, Stamped, now_ns
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
_ALL_SEEN = (1 << TAXEL_SHAPE[0]) - 1
# pyserial's SerialException is an OSError; a vanished tty raises termios.error
_BROKEN = (OSError, termios.error)


class SlcanScans:
    """SLCAN text → scans of 16 taxels; no I/O.

    The CAN id of a taxel has its row in bits 10-8, its column in 7-4, the patch's controller in
    3-0. Which way rows and columns run on the finger wasn't seen on hardware: run ``uniforce touch
    check=orientation``.

    A scan begins with the patch's first id and is delivered once all 16 were seen. One that repeats
    a taxel or begins anew before it is whole is dropped and counted: two scans never mix.

    ``controller`` is the patch's microcontroller id; ContractError where it is outside 0 … 15.
    """

    def __init__(self, controller: int = 0) -> None:
        if not 0 <= controller <= 15:
            raise ContractError(
                expected("controller", "0 … 15", controller, "Read it off `candump`.")
            )
        self.counts = SourceCounts()  # scans delivered, scans broken, lines that made no sense
        self._taxel_of = {
            (n // 4) << 8 | (n % 4) << 4 | controller: n for n in range(TAXEL_SHAPE[0])
        }
        self._scan = np.zeros(TAXEL_SHAPE, np.uint16)
        self.forget()

    def forget(self) -> None:
        """Drop what is half read, as after reopening the port."""
        self._tail = b""
        self._seen = 0  # one bit per taxel; 0 = waiting for a beginning

    def feed(self, chunk: bytes) -> list[np.ndarray]:
        """Return the scans, (16, 3) uint16 each, that ``chunk`` completes."""
        *lines, tail = (self._tail + chunk.replace(_BELL, b"")).split(b"\r")
        if len(tail) > MAX_TAIL_BYTES:
            self.counts.bad += 1
            tail = b""
        self._tail = tail
        scans = []
        for line in lines:
            scan = self._frame(line)
            if scan is not None:
                scans.append(scan)
        return scans

    def _frame(self, line: bytes) -> np.ndarray | None:
        match = _FRAME.fullmatch(line)
        if match is None:
            self.counts.bad += len(line) > MAX_TAIL_BYTES or _OTHER.fullmatch(line) is None
            return None
        taxel = self._taxel_of.get(int(match[1], 16))
        if taxel is None:
            return None
        return self._place(taxel, int(match[2][2:14], 16))

    def _place(self, taxel: int, word: int) -> np.ndarray | None:
        if self._seen >> taxel & 1:  # repeated, or the next scan began before this one was whole
            self.counts.lost += 1
            self._seen = 0
        if self._seen == 0 and taxel != 0:
            return None
        self._seen |= 1 << taxel
        self._scan[taxel] = word >> 32, word >> 16 & 0xFFFF, word & 0xFFFF
        if self._seen != _ALL_SEEN:
            return None
        self.counts.samples += 1
        self._seen = 0
        return self._scan.copy()


class SlcanUSkin(SampleSource):
    """Whole scans, (16, 3) uint16 raw counts, of a serial port like ``/dev/serial/by-id/usb-…``."""

    def __init__(self, port: str, name: str = "uskin", controller: int = 0) -> None:
        super().__init__(f"{name} ({port})")
        self._port = port
        self._scans = SlcanScans(controller)
        self._early = b""
        self.counts = self._scans.counts

    def _connect(self, undo: contextlib.ExitStack) -> None:
        """Open the port for ourselves and start the channel; ProtocolError: no adapter answers."""
        self._scans.forget()
        held = "that xela_server or slcand doesn't hold it"
        do = f"Check cable and permissions (group dialout), and {held}."
        timeouts = {"timeout": READ_TIMEOUT_S, "write_timeout": ANSWER_S}
        try:
            self._serial = serial.Serial(self._port, BAUD, exclusive=True, **timeouts)
            undo.callback(self._stop)
            self._serial.reset_input_buffer()
            for command in OPENING:
                # the channel streams from its last acknowledgement on
                self._early = self._command(command)
        except (*_BROKEN, ValueError) as error:
            raise LostSensorError(expected(self.name, "a serial port", error, do)) from error

    def _stop(self) -> None:
        with contextlib.suppress(*_BROKEN):  # unplugged: no channel left to close
            self._serial.write(b"C\r")
        with contextlib.suppress(*_BROKEN):  # its descriptor is released anyway
            self._serial.close()

    def read(self) -> list[Stamped]:
        """Return the scans that came, stamped when they were read."""
        scans = self._scans.feed(chunk := self._receive())
        while self._must_read_on(len(chunk) >= FULL_BYTES):
            scans += self._scans.feed(chunk := self._receive())
        stamp_ns = now_ns()
        return [Stamped(stamp_ns, scan) for scan in scans]

    def _receive(self) -> bytes:
        try:
            chunk = self._early + self._serial.read(max(1, self._serial.in_waiting))
            self._early = b""
            return chunk
        # TypeError: pyserial's descriptor vanished while it read
        except (*_BROKEN, TypeError) as error:
            do = "Was it unplugged? It is reopened once it is back."
            raise LostSensorError(expected(self.name, "a readable port", error, do)) from error

    def _command(self, command: bytes) -> bytes:
        """Send a command, skip data lines, and return the bytes after its acknowledgement."""
        self._serial.write(command + b"\r")
        deadline = time.monotonic() + ANSWER_S
        tail = b""
        came = "no answer"
        while time.monotonic() < deadline:
            chunk = self._serial.read(max(1, self._serial.in_waiting))
            *lines, tail = (tail[-64:] + chunk).split(b"\r")
            if _BELL in chunk and command != b"C":  # C: it was closed already
                came = "BEL (refused)"
                break
            if b"" in lines:
                return b"\r".join([*lines[lines.index(b"") + 1 :], tail])
            if _BELL in chunk:
                return b""
        what = f"{self.name}, command {command.decode()}"
        do = "Is this the SLCAN adapter, at 3 Mbaud?"
        raise ProtocolError(expected(what, "an acknowledgement", came, do))
