r"""SLCAN text → whole uSkin scans; no I/O.

A frame is ``tIIILDD…\r``: 11-bit id, length 8, eight bytes in hex, four more digits when the adapter stamps time.  The
eight bytes are unused, X, Y, Z (big-endian uint16), unused.  Sources: Lawicel CANUSB manual; XELA uSPa manual, 2023.
"""

from __future__ import annotations

import re

import numpy as np

from uniforce_robots.sensors.sources import SourceCounts
from uniforce_vtla.contracts import TAXEL_SHAPE
from uniforce_vtla.errors import ContractError, expected

BELL = 7  # the adapter's "error"
MAX_TAIL_BYTES = 64  # the longest legal line has 32; more without an end is noise
_FRAME = re.compile(rb"t([0-9A-Fa-f]{3})8([0-9A-Fa-f]{16})(?:[0-9A-Fa-f]{4})?")
_OTHER = re.compile(
    rb"|[zZ]|[VNF][0-9A-Za-z]*|t[0-9A-Fa-f]{3}[0-7].*|[TrR][0-9A-Fa-f]+"
)  # replies, other traffic
_TAXELS = TAXEL_SHAPE[0]
_ALL_SEEN = (1 << _TAXELS) - 1


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
    """Collects frames into scans of 16 taxels.

    A scan begins with the first id of the map and is delivered once all 16 were seen.  One that repeats a taxel or
    begins anew before it is whole is dropped and counted, up to the next beginning: taxels of two scans never mix.

    Args:
        ids: CAN id of each taxel, in the order of the rows delivered.

    Attributes:
        bells: BEL bytes met: the adapter refused or lost something.
        foreign: lines of other nodes or commands.

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
        self.bells = self.foreign = 0

    @property
    def counts(self) -> SourceCounts:
        """Scans delivered, scans broken, lines that made no sense."""
        return SourceCounts(self._scans, self._lost, self._bad)

    def forget(self) -> None:
        """Drop what is half read, as after reopening the port."""
        self._tail, self._seen = b"", 0

    def feed(self, chunk: bytes) -> list[np.ndarray]:
        """Return the scans, (16, 3) uint16 each, that ``chunk`` completes."""
        self.bells += chunk.count(BELL)
        *lines, tail = (self._tail + chunk.replace(b"\x07", b"")).split(b"\r")
        if len(tail) > MAX_TAIL_BYTES:
            self._bad, tail = self._bad + 1, b""
        self._tail = tail
        scans = [self._frame(line) for line in lines]
        return [scan for scan in scans if scan is not None]

    def _frame(self, line: bytes) -> np.ndarray | None:
        match = _FRAME.fullmatch(line)
        if match is None:
            known = len(line) <= MAX_TAIL_BYTES and _OTHER.fullmatch(line) is not None
            self.foreign, self._bad = self.foreign + known, self._bad + (not known)
            return None
        taxel = self._taxel_of.get(int(match[1], 16))
        if taxel is None:
            self.foreign += 1
            return None
        return self._place(taxel, int(match[2][2:14], 16))

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
