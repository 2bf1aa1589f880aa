r"""A uSkin behind an SLCAN adapter, on a pseudo-terminal.

Example: python -m uniforce_robots.standins.slcan rate_hz=500

Prints ``ready PATH``; open PATH as the serial port.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
from dataclasses import dataclass

import numpy as np

from uniforce_robots.standins.control import Control
from uniforce_robots.standins.pace import Pace
from uniforce_robots.standins.pseudo_terminal import PseudoTerminal
from uniforce_robots.standins.scene import SceneConfig, taxel_cycle
from uniforce_vtla.arguments import parse

FAULTS = ("bel", "garbage", "split", "missing", "duplicate", "stall", "freeze", "unplug", "refuse", "mute")
OUT_BYTES = 65_536  # what a tty's own buffers hold before data is lost
GARBAGE_BYTES = 40
REPLIES = {"V": b"V1013\r", "N": b"NUF01\r", "F": b"F00\r"}


@dataclass
class SlcanConfig(SceneConfig):
    """Show a simulated uSkin patch as an SLCAN adapter on a pseudo-terminal.

    Example: python -m uniforce_robots.standins.slcan rate_hz=500 where=top-left
    """

    rate_hz: float = 500.0  # scans per second; real 4×4 patches were seen at 95 to 133
    controller: int = 0  # microcontroller id in the low bits of the CAN ids


def scan_lines(cycle: np.ndarray, controller: int) -> list[list[bytes]]:
    r"""Return, per scan of (N, 16, 3) uint16, its 16 SLCAN lines, ``\r`` included."""
    ids = [(row << 8) | (column << 4) | controller for row in range(4) for column in range(4)]
    return [
        [b"t%03X893%04X%04X%04X0F\r" % (can_id, *xyz) for can_id, xyz in zip(ids, scan, strict=True)]
        for scan in cycle.tolist()
    ]


class SlcanStandIn:
    """The adapter: answers commands, and streams scans while its channel is open."""

    def __init__(self, config: SlcanConfig) -> None:
        self._lines = scan_lines(taxel_cycle(config.scene, config.rate_hz), config.controller)
        self._control = Control(FAULTS, self._on_fault, self._stats, config.fault)
        self._pace = Pace(config.rate_hz)
        self._rng = np.random.default_rng(config.seed)
        self._port = PseudoTerminal("slcan")
        self._out, self._in = bytearray(), b""
        self._is_open = False
        self._step = self._sent = self._dropped = 0

    def run(self) -> None:
        """Serve until told to quit."""
        self._port.serve(self._control, self._serve_once)

    def _serve_once(self) -> None:
        plugged = self._port.inputs()
        wait_s = self._pace.wait_s() if self._is_open else 0.1
        writable = plugged if self._out else []
        ready, can_write, _ = select.select([*plugged, *self._control.inputs()], writable, [], wait_s)
        if 0 in ready:
            self._control.read()
        if self._port.master in ready:
            self._answer(os.read(self._port.master, 4096))
        if self._is_open:
            self._stream()
        if self._out and (can_write or not writable) and self._port.master >= 0:
            self._flush()

    # -- the adapter's commands -------------------------------------------------------------------------

    def _answer(self, chunk: bytes) -> None:
        if self._control.fault == "mute":
            return
        *commands, self._in = (self._in + chunk).split(b"\r")
        self._in = self._in[-64:]
        for command in commands:
            self._out += self._reply(command.decode(errors="replace"))

    def _reply(self, command: str) -> bytes:
        if self._control.fault == "refuse":
            return b"\x07"
        was_open = self._is_open
        if command == "O":
            self._is_open = True
            self._pace.restart()
        elif command == "C":
            self._is_open = False
            return b"\r" if was_open else b"\x07"  # Lawicel adapters refuse to close what is closed
        return REPLIES.get(command[:1], b"\r")

    # -- the patch's scans ------------------------------------------------------------------------------

    def _stream(self) -> None:
        for _ in range(self._pace.due()):
            if self._control.fault == "stall":
                continue
            chunk = self._broken(list(self._lines[self._step % len(self._lines)]))
            self._step += self._control.fault != "freeze"
            if len(self._out) + len(chunk) > OUT_BYTES:
                self._dropped += 1
            else:
                self._sent += 1
                self._out += chunk

    def _broken(self, lines: list[bytes]) -> bytes:
        fault = self._control.fault
        if fault == "bel":
            lines.insert(int(self._rng.integers(16)), b"\x07")
        elif fault == "garbage":
            lines.insert(0, self._rng.bytes(GARBAGE_BYTES) + b"\r")
        elif fault == "missing":
            del lines[7]
        elif fault == "duplicate":
            lines.insert(7, lines[7])
        return b"".join(lines)

    def _flush(self) -> None:
        size = int(self._rng.integers(1, 9)) if self._control.fault == "split" else len(self._out)
        with contextlib.suppress(BlockingIOError):
            for _ in range(64 if self._control.fault == "split" else 1):
                written = os.write(self._port.master, self._out[:size])
                del self._out[:written]

    # -- plugging ---------------------------------------------------------------------------------------

    def _on_fault(self, name: str) -> None:
        if name != "unplug":
            self._port.plug()
            return
        self._port.unplug()
        self._out.clear()
        self._is_open = False

    def _stats(self) -> str:
        return f"sent={self._sent} dropped={self._dropped} waiting={len(self._out)}"


def main(argv: list[str] | None = None) -> int:
    """Entry of ``python -m uniforce_robots.standins.slcan``."""
    with contextlib.suppress(KeyboardInterrupt):
        SlcanStandIn(parse(SlcanConfig, argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
