"""A GELLO: eight Dynamixel motors that speak protocol 2.0 on a pseudo-terminal; see ``--help``."""

import struct
import sys
import time
from dataclasses import dataclass

import numpy as np

from uniforce_robots.fr3 import HOME_q_rad
from uniforce_robots.standins.control import StandInServer
from uniforce_robots.standins.plugs import READ_BYTES, PseudoTerminal
from uniforce_vtla.arguments import parse

HEADER = b"\xff\xff\xfd\x00"
COUNTS_PER_TURN = 4096
GARBAGE_BYTES = 40
MISSING = 4  # the motor that the fault "missing" silences
JUMP_rad = 1.5
PERIOD_s = 4.0  # of the swing
IDLE_hz = 10.0  # nothing is sent unasked


@dataclass
class GelloConfig:
    """Show eight Dynamixel motors, the Franka's home posture and a trigger, on a pseudo-terminal.

    Example: cd tests; python -m standins.gello swing_rad=0.1 fault=crc
    """

    swing_rad: float = 0.05  # how far each joint swings about home
    fault: str = "none"  # what is broken from the start
    seed: int = 0


def checksum(data):
    """CRC-16, polynomial 0x8005, bit by bit from the e-manual's text."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1) ^ 0x8005 if value & 0x8000 else value << 1
        value &= 0xFFFF
    return value


def status(motor, parameters, error=0):
    """Return a motor's answer, ``FD`` stuffed in where its content looks like a header."""
    content = b"\x55" + bytes([error]) + parameters
    body = content.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = HEADER + struct.pack("<BH", motor, len(body) + 2) + body
    return head + struct.pack("<H", checksum(head))


class GelloStandIn(StandInServer):
    """Answers pings, reads and sync reads of any address as if it held the position."""

    faults = ("crc", "missing", "garbage", "split", "mute", "jump", "alert", "unplug")

    def __init__(self, config):
        self._port = PseudoTerminal("gello")
        super().__init__(self._port, self._port.address, config, IDLE_hz)
        self._in = b""

    def on_fault(self):
        super().on_fault()
        self._port.pieces = 3 if self.fault == "split" else READ_BYTES

    def answer(self, received):
        """Answer the whole questions that came; one with a wrong checksum gets none."""
        self._in = (self._in + received)[-READ_BYTES:]
        while (start := self._in.find(HEADER)) >= 0:
            self._in = self._in[start:]
            size = 7 + int.from_bytes(self._in[5:7], "little")
            if len(self._in) < size:
                return
            whole = self._in[:size]
            self._in = self._in[size:]
            is_sound = checksum(whole[:-2]) == int.from_bytes(whole[-2:], "little")
            data = b""
            if is_sound and self.fault != "mute":
                data = self._answer(whole[7], whole[4], whole[8:-2])
            if data:
                self.plug.send(self.rng.bytes(GARBAGE_BYTES) if self.fault == "garbage" else data)

    def _answer(self, instruction, motor, parameters):
        if instruction == 0x01:  # ping: model number and firmware
            return status(motor, struct.pack("<HB", 1200, 45))
        asked = {0x02: bytes([motor]), 0x82: parameters[4:]}.get(instruction, b"")
        counts = self._counts()
        return b"".join(self._position(motor, counts) for motor in asked)

    def _counts(self):
        phase = 2 * np.pi * time.monotonic() / PERIOD_s
        joints = HOME_q_rad + self.config.swing_rad * np.sin(phase)
        jumped = joints + JUMP_rad * (self.fault == "jump")
        return np.round(np.append(jumped, 0.0) * COUNTS_PER_TURN / (2 * np.pi)).astype(int)

    def _position(self, motor, counts):
        if not 1 <= motor <= len(counts) or (self.fault == "missing" and motor == MISSING):
            return b""
        error = 0x80 if self.fault == "alert" else 0
        answer = status(motor, struct.pack("<i", int(counts[motor - 1])), error)
        if self.fault == "crc" and motor == MISSING:
            return answer[:-1] + bytes([answer[-1] ^ 0x55])
        return answer


if __name__ == "__main__":
    sys.exit(GelloStandIn(parse(GelloConfig)).run())
