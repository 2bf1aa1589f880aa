"""Dynamixel protocol 2.0, as much of it as reading positions takes: sync read, status packets, CRC-16.

Written from the maker's e-manual. A packet is ``FF FF FD 00 id length instruction parameters crc``; where the
parameters hold ``FF FF FD`` another ``FD`` is stuffed in.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
SYNC_READ, STATUS = 0x82, 0x55
PRESENT_POSITION, POSITION_BYTES = 132, 4  # control table of the X series
COUNTS_PER_TURN = 4096
_MAX_LENGTH = 256  # a status of four bytes has length 8; nothing here comes near
_STUFFED, _PLAIN = b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = ((value << 1) ^ 0x8005 if value & 0x8000 else value << 1) & 0xFFFF
        table.append(value)
    return tuple(table)


_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """Return the checksum of a packet up to its checksum: polynomial 0x8005, start 0, nothing reflected."""
    value = 0
    for byte in data:
        value = ((value << 8) & 0xFFFF) ^ _TABLE[(value >> 8) ^ byte]
    return value


def packet(device_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a whole packet."""
    body = (bytes([instruction]) + parameters).replace(_PLAIN, _STUFFED)
    head = HEADER + struct.pack("<BH", device_id, len(body) + 2) + body
    return head + struct.pack("<H", crc16(head))


def sync_read(ids: tuple[int, ...], address: int = PRESENT_POSITION, size: int = POSITION_BYTES) -> bytes:
    """Return the request on which each of ``ids`` answers with ``size`` bytes from ``address``."""
    return packet(BROADCAST, SYNC_READ, struct.pack("<HH", address, size) + bytes(ids))


@dataclass(frozen=True)
class Status:
    """One answer: who, its error byte (0 = none; bit 7 = a hardware alert) and the parameters."""

    device_id: int
    error: int
    parameters: bytes


class StatusReader:
    """Finds status packets in a stream that may hold anything else; keeps at most one packet's bytes.

    Attributes:
        bad: packets with a wrong checksum or impossible length.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._buffer = b""

    def forget(self) -> None:
        """Drop what was begun: it belongs to an earlier question."""
        self._buffer = b""

    def feed(self, data: bytes) -> list[Status]:
        """Take bytes and return the answers they complete."""
        self._buffer += data
        found: list[Status] = []
        while (size := self._next_size()) is not None:
            whole, self._buffer = self._buffer[:size], self._buffer[size:]
            found += self._status(whole)
        return found

    def _next_size(self) -> int | None:
        """Bring the next header to the front; return its packet's size, None while it isn't whole."""
        while True:
            start = self._buffer.find(HEADER)
            # no header: keep what may be the beginning of one
            self._buffer = self._buffer[start:] if start >= 0 else self._buffer[-(len(HEADER) - 1) :]
            if start < 0 or len(self._buffer) < 7:
                return None
            length = int.from_bytes(self._buffer[5:7], "little")
            if 4 <= length <= _MAX_LENGTH:  # instruction, error and checksum at least
                return 7 + length if len(self._buffer) >= 7 + length else None
            self.bad += 1
            self._buffer = self._buffer[len(HEADER) :]

    def _status(self, whole: bytes) -> list[Status]:
        if int.from_bytes(whole[-2:], "little") != crc16(whole[:-2]):
            self.bad += 1
            self._buffer = (
                whole[len(HEADER) :] + self._buffer
            )  # a good packet may hide in a broken one's claim
            return []
        body = whole[7:-2].replace(_STUFFED, _PLAIN)
        if body[0] != STATUS:  # our own question, echoed by a half-duplex adapter
            return []
        return [Status(whole[4], body[1], body[2:])]
