r"""A SpaceMouse that delivers HID reports on a local packet socket: one read is one report, as with hidraw.

Example: python -m uniforce_robots.standins.spacemouse push=100,0,0,0,0,0

A FIFO or a pseudo-terminal would glue reports together, which hidraw never does.  Prints ``ready PATH``; connect a
SOCK_SEQPACKET socket to PATH.  On standard input: ``fault NAME``, ``stats``, ``quit``.
"""

from __future__ import annotations

import socket
import struct
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_robots.standins.control import Pace, StandInServer
from uniforce_vtla.arguments import parse

BURST = 40  # reports at once: what a reader that sleeps would find queued
AXES = 6


@dataclass
class SpaceMouseConfig:
    """Show a SpaceMouse: at rest it is silent, with the fault ``push`` its cap is deflected.

    Example: python -m uniforce_robots.standins.spacemouse push=100,0,0,0,0,0
    """

    push: str = "0,-350,0,0,0,0"  # counts of x, y, z and the turns about them while pushed
    rate_hz: float = 60.0  # wireless ones were seen at some 62
    fault: str = "none"  # what it does from the start
    seed: int = 0


def reports(counts: tuple[int, ...], buttons: int, layout: str = "three") -> list[bytes]:
    """Return the reports of one state: three axes in each of two, or all ``six`` in one."""
    button = struct.pack("<BH", 3, buttons)
    if layout == "six":
        return [struct.pack("<B6h", 1, *counts), button]
    return [struct.pack("<B3h", 1, *counts[:3]), struct.pack("<B3h", 2, *counts[3:]), button]


class PacketSocket:
    """A listener at a path of the file system, and the one who connected to it."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="uniforce-spacemouse-")
        self.path = Path(self._folder.name) / "device"
        self.listener: socket.socket | None = None
        self.reader: socket.socket | None = None
        self.plug()

    def plug(self) -> None:
        """Listen; does nothing when it does."""
        if self.listener is None:
            self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self.listener.bind(str(self.path))
            self.listener.listen(1)

    def unplug(self) -> None:
        """Close both and take the path away."""
        for link in (self.reader, self.listener):
            if link is not None:
                link.close()
        self.reader = self.listener = None
        self.path.unlink(missing_ok=True)

    def accept(self, ready: list[Any]) -> None:
        """Take a new reader if one waits."""
        if self.listener in ready and self.listener is not None:
            self.reader, _ = self.listener.accept()
            self.reader.setblocking(False)


class SpaceMouseStandIn(StandInServer):
    """Sends the pushed state at its rate, the state of rest once."""

    faults = ("push", "close", "freeze", "garbage", "short", "burst", "unplug")

    def __init__(self, config: SpaceMouseConfig) -> None:
        self._push = tuple(int(word) for word in config.push.split(","))
        self._pace = Pace(config.rate_hz)
        self._rng = np.random.default_rng(config.seed)
        self._socket = PacketSocket()
        super().__init__(self._socket, str(self._socket.path), config.fault)
        self._sent = self._dropped = 0

    def waits_for(self) -> tuple[list[Any], list[Any], float]:
        """Return the listener and the time to the next report."""
        listener = self._socket.listener
        return [] if listener is None else [listener], [], self._pace.wait_s()

    def serve(self, ready: list[Any], writable: list[Any]) -> None:
        """Take a reader, send the reports that are due."""
        self._socket.accept(ready)
        for _ in range(self._pace.due()):
            for report in self._due():
                self._send(report)

    def stats(self) -> str:
        """Return reports sent and dropped."""
        return f"sent={self._sent} dropped={self._dropped}"

    def on_fault(self) -> None:
        """Send the state of rest once, where the cap is let go."""
        super().on_fault()
        for report in reports((0,) * AXES, 0) if self.fault == "none" else []:
            self._send(report)

    def _due(self) -> list[bytes]:
        match self.fault:
            case "push":
                return reports(self._push, 0)
            case "burst":
                return reports(self._push, 0) * BURST
            case "close":
                return reports((0,) * AXES, 1)
            case "garbage":
                return [bytes([self._rng.choice([1, 2])]) + b"\xff\x7f" * 3]
            case "short":
                return [b"\x01\x00"]
        return []  # at rest, or frozen: silent

    def _send(self, report: bytes) -> None:
        if self._socket.reader is None:
            return
        try:
            self._socket.reader.send(report)
            self._sent += 1
        except BlockingIOError:
            self._dropped += 1
        except OSError:
            self._socket.reader = None  # it closed its end


if __name__ == "__main__":
    sys.exit(SpaceMouseStandIn(parse(SpaceMouseConfig)).run())
