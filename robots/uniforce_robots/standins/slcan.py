"""A uSkin behind an SLCAN adapter: ``python -m uniforce_robots.standins.slcan --help``."""

import sys
from dataclasses import dataclass

import numpy as np

from uniforce_robots.standins.control import StandInServer
from uniforce_robots.standins.plugs import READ_BYTES, PseudoTerminal
from uniforce_robots.standins.scene import Scene, taxel_cycle
from uniforce_vtla.arguments import parse

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
    line = b"t%03X893%04X%04X%04X0F\r"
    return [[line % (n, *xyz) for n, xyz in zip(ids, scan, strict=True)] for scan in cycle.tolist()]


class SlcanStandIn(StandInServer):
    """The adapter: answers commands, and streams scans while its channel is open."""

    faults = (
        "bel",
        "garbage",
        "split",
        "missing",
        "duplicate",
        "stall",
        "freeze",
        "unplug",
        "refuse",
        "mute",
    )

    def __init__(self, config: SlcanConfig) -> None:
        self._lines = scan_lines(taxel_cycle(config, config.rate_hz), config.controller)
        self._port = PseudoTerminal("slcan")
        super().__init__(self._port, self._port.address, config, config.rate_hz)
        self._in = b""
        self._is_open = False

    def on_fault(self) -> None:
        """Break; a patch without power forgets its channel."""
        super().on_fault()
        self._port.pieces = 3 if self.fault == "split" else READ_BYTES
        self._is_open = self._is_open and self.fault != "unplug"

    def answer(self, received: bytes) -> None:
        """Answer commands."""
        *commands, tail = (self._in + received).split(b"\r")
        self._in = tail[-64:]
        if self.fault == "mute":
            return
        for command in commands:
            self._port.out += self._reply(command.decode(errors="replace"))

    def _reply(self, command: str) -> bytes:
        if self.fault == "refuse":
            return b"\x07"
        was_open = self._is_open
        if command == "O":
            self._is_open = True
            self.pace.restart()
        elif command == "C":
            self._is_open = False
            return b"\r" if was_open else b"\x07"  # Lawicel adapters refuse to close what is closed
        return REPLIES.get(command[:1], b"\r")

    def beat(self) -> None:
        """Send a scan."""
        if not self._is_open or self.fault == "stall":
            return
        lines = list(self._lines[self.next_step() % len(self._lines)])
        if self.fault == "bel":
            lines.insert(int(self.rng.integers(16)), b"\x07")
        elif self.fault == "garbage":
            lines.insert(0, self.rng.bytes(GARBAGE_BYTES) + b"\r")
        elif self.fault == "missing":
            del lines[7]
        elif self.fault == "duplicate":
            lines.insert(7, lines[7])
        self.plug.send(b"".join(lines))


if __name__ == "__main__":
    sys.exit(SlcanStandIn(parse(SlcanConfig)).run())
