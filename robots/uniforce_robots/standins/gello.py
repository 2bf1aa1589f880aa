r"""A GELLO: eight Dynamixel motors that speak protocol 2.0 on a pseudo-terminal.

Example: python -m uniforce_robots.standins.gello swing_rad=0.1

Prints ``ready PATH``; open PATH as the serial port.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import os
import select
import struct
import sys
import time
from dataclasses import dataclass

import numpy as np

from uniforce_robots.standins.control import Control
from uniforce_robots.standins.fci.kinematics import HOME_q_rad
from uniforce_robots.standins.pseudo_terminal import PseudoTerminal
from uniforce_vtla.arguments import parse

FAULTS = ("crc", "missing", "garbage", "split", "mute", "jump", "alert", "unplug")
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
    """CRC-16, polynomial 0x8005, bit by bit from the e-manual's text: the driver's is by table."""
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


class GelloStandIn:
    """Answers pings, reads and sync reads of any address as if it held the position."""

    def __init__(self, config: GelloConfig) -> None:
        self._config = config
        self._port = PseudoTerminal("gello")
        self._control = Control(FAULTS, self._on_fault, self._stats, config.fault)
        self._rng = np.random.default_rng(config.seed)
        self._in = b""
        self._asked = self._refused = 0
        self._start_s = time.monotonic()

    def run(self) -> None:
        """Serve until told to quit."""
        self._port.serve(self._control, self._serve_once)

    def counts(self) -> np.ndarray:
        """(8,) positions now, as the motors count them."""
        phase = 2 * np.pi * (time.monotonic() - self._start_s) / self._config.period_s
        joints = HOME_q_rad + self._config.swing_rad * np.sin(phase)
        joints = joints + (JUMP_rad if self._control.fault == "jump" else 0.0)
        angles = np.array([*joints, self._config.trigger_rad])
        return np.round(angles * COUNTS_PER_TURN / (2 * np.pi)).astype(int)

    def _serve_once(self) -> None:
        ready, _, _ = select.select([*self._port.inputs(), *self._control.inputs()], [], [], 0.1)
        if 0 in ready:
            self._control.read()
        if self._port.master in ready:
            with contextlib.suppress(OSError):  # nobody has opened the port at the moment
                self._in = (self._in + os.read(self._port.master, 4096))[-4096:]
            self._answer_all()

    def _answer_all(self) -> None:
        while (start := self._in.find(HEADER)) >= 0:
            self._in = self._in[start:]
            if len(self._in) < 7 or len(self._in) < 7 + int.from_bytes(self._in[5:7], "little"):
                return
            size = 7 + int.from_bytes(self._in[5:7], "little")
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
        fault = self._control.fault
        if not 1 <= motor <= len(positions) or (fault == "missing" and motor == MISSING):
            return b""
        error = 0x80 if fault == "alert" else 0
        answer = status(motor, struct.pack("<i", int(positions[motor - 1])), error)
        if fault == "crc" and motor == MISSING:
            return answer[:-1] + bytes([answer[-1] ^ 0x55])
        return answer

    def _send(self, data: bytes) -> None:
        fault = self._control.fault
        if fault == "mute":
            return
        if fault == "garbage":
            data = self._rng.bytes(GARBAGE_BYTES)
        size = 3 if fault == "split" else max(len(data), 1)
        with contextlib.suppress(BlockingIOError):
            for start in range(0, len(data), size):
                os.write(self._port.master, data[start : start + size])

    def _on_fault(self, name: str) -> None:
        if name == "unplug":
            self._port.unplug()
        else:
            self._port.plug()

    def _stats(self) -> str:
        return f"asked={self._asked} refused={self._refused}"


def main(argv: list[str] | None = None) -> int:
    """Entry of ``python -m uniforce_robots.standins.gello``."""
    with contextlib.suppress(KeyboardInterrupt):
        GelloStandIn(parse(GelloConfig, argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
