r"""A uSkin behind an SLCAN adapter, on a pseudo-terminal.

Example: python -m uniforce_robots.standins.slcan rate_hz=500

Prints ``ready PATH``; open PATH as the serial port.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import os
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np

from uniforce_robots.standins.control import Pace, StandInServer
from uniforce_robots.standins.pseudo_terminal import PseudoTerminal
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.arguments import parse

OUT_BYTES = 65_536  # what a tty's own buffers hold before data is lost
GARBAGE_BYTES = 40
REPLIES = {"V": b"V1013\r", "N": b"NUF01\r", "F": b"F00\r"}


@dataclass
class SlcanConfig(Scene):
    """Show a simulated uSkin patch as an SLCAN adapter on a pseudo-terminal.

    Example: python -m uniforce_robots.standins.slcan rate_hz=500 where=top-left
    """

    rate_hz: float = 500.0  # scans per second; real 4×4 patches were seen at 95 to 133
    fault: str = "none"  # what is broken from the start
    controller: int = 0  # microcontroller id in the low bits of the CAN ids


def scan_lines(cycle: np.ndarray, controller: int) -> list[list[bytes]]:
    r"""Return, per scan of (N, 16, 3) uint16, its 16 SLCAN lines, ``\r`` included."""
    ids = [(row << 8) | (column << 4) | controller for row in range(4) for column in range(4)]
    return [
        [b"t%03X893%04X%04X%04X0F\r" % (can_id, *xyz) for can_id, xyz in zip(ids, scan, strict=True)]
        for scan in cycle.tolist()
    ]


class SlcanStandIn(StandInServer):
    """The adapter: answers commands, and streams scans while its channel is open."""

    faults = (
        *("bel", "garbage", "split", "missing", "duplicate", "stall", "freeze"),
        *("unplug", "refuse", "mute"),
    )

    def __init__(self, config: SlcanConfig) -> None:
        self._lines = scan_lines(taxel_cycle(config, config.rate_hz), config.controller)
        self._pace = Pace(config.rate_hz)
        self._rng = np.random.default_rng(config.seed)
        self._port = PseudoTerminal("slcan")
        super().__init__(self._port, str(self._port.path), config.fault)
        self._out, self._in = bytearray(), b""
        self._is_open = False
        self._step = self._sent = self._dropped = 0

    def waits_for(self) -> tuple[list[Any], list[Any], float]:
        """Return the port and the time to the next scan."""
        ends = self._port.ends()
        return ends, ends if self._out else [], self._pace.wait_s() if self._is_open else 0.1

    def serve(self, ready: list[Any], writable: list[Any]) -> None:
        """Answer commands, stream the scans that are due."""
        if self._port.master in ready:
            self._answer(os.read(self._port.master, 4096))
        if self._is_open:
            self._stream()
        if self._out and self._port.master >= 0:
            self._flush()

    def stats(self) -> str:
        """Return scans sent and dropped, and the bytes that wait."""
        return f"sent={self._sent} dropped={self._dropped} waiting={len(self._out)}"

    def on_fault(self) -> None:
        """A patch without power forgets its channel."""
        super().on_fault()
        if self.fault == "unplug":
            self._out.clear()
            self._is_open = False

    def _answer(self, chunk: bytes) -> None:
        if self.fault == "mute":
            return
        *commands, self._in = (self._in + chunk).split(b"\r")
        self._in = self._in[-64:]
        for command in commands:
            self._out += self._reply(command.decode(errors="replace"))

    def _reply(self, command: str) -> bytes:
        if self.fault == "refuse":
            return b"\x07"
        was_open = self._is_open
        if command == "O":
            self._is_open = True
            self._pace.restart()
        elif command == "C":
            self._is_open = False
            return b"\r" if was_open else b"\x07"  # Lawicel adapters refuse to close what is closed
        return REPLIES.get(command[:1], b"\r")

    def _stream(self) -> None:
        for _ in range(self._pace.due()):
            if self.fault == "stall":
                continue
            chunk = self._broken(list(self._lines[self._step % len(self._lines)]))
            self._step += self.fault != "freeze"
            if len(self._out) + len(chunk) > OUT_BYTES:
                self._dropped += 1
            else:
                self._sent += 1
                self._out += chunk

    def _broken(self, lines: list[bytes]) -> bytes:
        if self.fault == "bel":
            lines.insert(int(self._rng.integers(16)), b"\x07")
        elif self.fault == "garbage":
            lines.insert(0, self._rng.bytes(GARBAGE_BYTES) + b"\r")
        elif self.fault == "missing":
            del lines[7]
        elif self.fault == "duplicate":
            lines.insert(7, lines[7])
        return b"".join(lines)

    def _flush(self) -> None:
        size = int(self._rng.integers(1, 9)) if self.fault == "split" else len(self._out)
        with contextlib.suppress(BlockingIOError):
            for _ in range(64 if self.fault == "split" else 1):
                written = os.write(self._port.master, self._out[:size])
                del self._out[:written]


if __name__ == "__main__":
    sys.exit(SlcanStandIn(parse(SlcanConfig)).run())
