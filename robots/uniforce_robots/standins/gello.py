r"""A GELLO: eight Dynamixel motors that speak protocol 2.0 on a pseudo-terminal.

Example: python -m uniforce_robots.standins.gello swing_rad=0.1

Prints ``ready PATH``; open PATH as the serial port.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from uniforce_robots.fr3 import HOME_q_rad
from uniforce_robots.standins.control import StandInServer
from uniforce_robots.standins.pseudo_terminal import PseudoTerminal
from uniforce_vtla.arguments import parse

HEADER = b"\xff\xff\xfd\x00"
COUNTS_PER_TURN = 4096
GARBAGE_BYTES = 40
MISSING = 4  # the motor that the fault "missing" silences
JUMP_rad = 1.5


@dataclass
class GelloConfig:
    """Show eight Dynamixel motors, the Franka's home posture and a trigger, on a pseudo-terminal.

    Example: python -m uniforce_robots.standins.gello swing_rad=0.1 fault=crc
    """

    swing_rad: float = 0.05  # how far each joint swings about home
    period_s: float = 4.0  # of the swing
    trigger_rad: float = 0.0  # where the trigger stands
    fault: str = "none"  # what is broken from the start
    seed: int = 0


def checksum(data: bytes) -> int:
    """CRC-16, polynomial 0x8005, bit by bit from the e-manual's text."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        value &= 0xFFFF
    return value


def status(motor: int, parameters: bytes, error: int = 0) -> bytes:
    """Return a motor's answer, ``FD`` stuffed in where its content looks like a header."""
    content = b"\x55" + bytes([error]) + parameters
    body = content.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = HEADER + struct.pack("<BH", motor, len(body) + 2) + body
    return head + struct.pack("<H", checksum(head))


class GelloStandIn(StandInServer):
    """Answers pings, reads and sync reads of any address as if it held the position."""

    faults = ("crc", "missing", "garbage", "split", "mute", "jump", "alert", "unplug")

    def __init__(self, config: GelloConfig) -> None:
        self._config = config
        self._port = PseudoTerminal("gello")
        super().__init__(self._port, str(self._port.path), config.fault)
        self._rng = np.random.default_rng(config.seed)
        self._in = b""
        self._asked = self._refused = 0
        self._start_s = time.monotonic()

    def waits_for(self) -> tuple[list[Any], list[Any], float]:
        """Return the port; nothing is sent unasked."""
        return self._port.ends(), [], 0.1

    def serve(self, ready: list[Any], writable: list[Any]) -> None:
        """Answer the questions that came."""
        if self._port.master in ready:
            with contextlib.suppress(OSError):  # no reader has opened the port at the moment
                self._in = (self._in + os.read(self._port.master, 4096))[-4096:]
            self._answer_all()

    def stats(self) -> str:
        """Return questions answered and refused."""
        return f"asked={self._asked} refused={self._refused}"

    def counts(self) -> np.ndarray:
        """(8,) positions now, as the motors count them."""
        phase = 2 * np.pi * (time.monotonic() - self._start_s) / self._config.period_s
        joints = HOME_q_rad + self._config.swing_rad * np.sin(phase)
        joints = joints + (JUMP_rad if self.fault == "jump" else 0.0)
        angles = np.array([*joints, self._config.trigger_rad])
        return np.round(angles * COUNTS_PER_TURN / (2 * np.pi)).astype(int)

    def _answer_all(self) -> None:
        while (start := self._in.find(HEADER)) >= 0:
            self._in = self._in[start:]
            size = 7 + int.from_bytes(self._in[5:7], "little")
            if len(self._in) < max(size, 7):
                return
            whole, self._in = self._in[:size], self._in[size:]
            self._answer(whole)

    def _answer(self, whole: bytes) -> None:
        if checksum(whole[:-2]) != int.from_bytes(whole[-2:], "little"):
            self._refused += 1
            return
        self._asked += 1
        instruction, parameters = whole[7], whole[8:-2]
        positions = self.counts()
        if instruction == 0x01:  # ping: model number and firmware
            self._send(status(whole[4], struct.pack("<HB", 1200, 45)))
        elif instruction == 0x02:
            self._send(self._position(whole[4], positions))
        elif instruction == 0x82:
            self._send(b"".join(self._position(motor, positions) for motor in parameters[4:]))

    def _position(self, motor: int, positions: np.ndarray) -> bytes:
        if not 1 <= motor <= len(positions) or (self.fault == "missing" and motor == MISSING):
            return b""
        error = 0x80 if self.fault == "alert" else 0
        answer = status(motor, struct.pack("<i", int(positions[motor - 1])), error)
        if self.fault == "crc" and motor == MISSING:
            return answer[:-1] + bytes([answer[-1] ^ 0x55])
        return answer

    def _send(self, data: bytes) -> None:
        if self.fault == "mute":
            return
        if self.fault == "garbage":
            data = self._rng.bytes(GARBAGE_BYTES)
        size = 3 if self.fault == "split" else max(len(data), 1)
        with contextlib.suppress(BlockingIOError):
            for start in range(0, len(data), size):
                os.write(self._port.master, data[start : start + size])


if __name__ == "__main__":
    sys.exit(GelloStandIn(parse(GelloConfig)).run())
