r"""A SpaceMouse that delivers HID reports on a local packet socket: one read is one report, as with hidraw.

Example: python -m uniforce_robots.standins.spacemouse push=100,0,0,0,0,0

A FIFO or a pseudo-terminal would glue reports together, which hidraw never does.  Prints ``ready PATH``; connect a
SOCK_SEQPACKET socket to PATH.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uniforce_robots.standins.control import Control
from uniforce_robots.standins.pace import Pace
from uniforce_vtla.arguments import parse

FAULTS = ("push", "close", "freeze", "garbage", "short", "burst", "unplug")
BURST = 40  # reports at once: what a reader that sleeps would find queued
AXES = 6


@dataclass
class SpaceMouseConfig:
    """Show a SpaceMouse: at rest it is silent, with the fault ``push`` its cap is deflected.

    Example: python -m uniforce_robots.standins.spacemouse push=100,0,0,0,0,0 layout=six
    """

    push: str = "0,-350,0,0,0,0"  # counts of x, y, z and the turns about them while pushed
    layout: str = "three"  # three axes in each of two reports, or six in one
    rate_hz: float = 60.0  # wireless ones were seen at some 62
    fault: str = "none"  # what it does from the start
    seed: int = 0


def reports(counts: tuple[int, ...], buttons: int, layout: str) -> list[bytes]:
    """Return the reports of one state."""
    button = struct.pack("<BH", 3, buttons)
    if layout == "six":
        return [struct.pack("<B6h", 1, *counts), button]
    return [struct.pack("<B3h", 1, *counts[:3]), struct.pack("<B3h", 2, *counts[3:]), button]


class SpaceMouseStandIn:
    """Sends the pushed state at its rate, the state of rest once."""

    def __init__(self, config: SpaceMouseConfig) -> None:
        self._config = config
        self._push = tuple(int(word) for word in config.push.split(","))
        self._control = Control(FAULTS, self._on_fault, self._stats, config.fault)
        self._pace = Pace(config.rate_hz)
        self._rng = np.random.default_rng(config.seed)
        self._folder = tempfile.TemporaryDirectory(prefix="uniforce-spacemouse-")
        self._path = Path(self._folder.name) / "device"
        self._server: socket.socket | None = None
        self._reader: socket.socket | None = None
        self._sent = self._dropped = 0
        self._plug()

    def run(self) -> None:
        """Serve until told to quit."""
        self._control.ready(str(self._path))
        try:
            while not self._control.quit:
                self._serve_once()
        finally:
            self._unplug()
            self._folder.cleanup()

    def _serve_once(self) -> None:
        door = -1 if self._server is None else self._server.fileno()
        waiting = [door] if door >= 0 else []
        ready, _, _ = select.select([*waiting, *self._control.inputs()], [], [], self._pace.wait_s())
        if 0 in ready:
            self._control.read()
        if self._server is not None and door in ready:
            self._reader, _ = self._server.accept()
            self._reader.setblocking(False)
        for _ in range(self._pace.due()):
            for report in self._due():
                self._send(report)

    def _due(self) -> list[bytes]:
        fault = self._control.fault
        if fault in ("push", "burst"):
            return reports(self._push, 0, self._config.layout) * (BURST if fault == "burst" else 1)
        if fault == "close":
            return reports((0,) * AXES, 1, self._config.layout)
        if fault == "garbage":
            return [bytes([self._rng.choice([1, 2])]) + b"\xff\x7f" * 3]
        if fault == "short":
            return [b"\x01\x00"]
        return []  # at rest, or frozen: silent

    def _on_fault(self, name: str) -> None:
        if name == "unplug":
            self._unplug()
            return
        self._plug()
        if name == "none":
            for report in reports((0,) * AXES, 0, self._config.layout):
                self._send(report)

    def _send(self, report: bytes) -> None:
        if self._reader is None:
            return
        try:
            self._reader.send(report)
            self._sent += 1
        except BlockingIOError:
            self._dropped += 1
        except OSError:
            self._reader = None  # it hung up

    def _plug(self) -> None:
        if self._server is not None:
            return
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(self._path))
        self._server.listen(1)
        self._pace.restart()

    def _unplug(self) -> None:
        for link in (self._reader, self._server):
            if link is not None:
                link.close()
        self._reader = self._server = None
        self._path.unlink(missing_ok=True)

    def _stats(self) -> str:
        return f"sent={self._sent} dropped={self._dropped}"


def main(argv: list[str] | None = None) -> int:
    """Entry of ``python -m uniforce_robots.standins.spacemouse``."""
    with contextlib.suppress(KeyboardInterrupt):
        SpaceMouseStandIn(parse(SpaceMouseConfig, argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
