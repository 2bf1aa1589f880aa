"""What every stand-in shares: it keeps a rate, and obeys lines on its standard input."""

from __future__ import annotations

import os
import select
import stat
import sys
import time
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Protocol

from uniforce_vtla.errors import ContractError, expected

READ_BYTES = 4096
MAX_BEHIND_S = 0.25  # after a longer gap (a stopped process, a stall) the past is left out


class Pace:
    """Counts the beats of ``rate_hz`` that are due: late ones at once, none of a long gap."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._next_s = time.monotonic()

    def due(self) -> int:
        """Return the beats due now, and count them as done."""
        behind_s = time.monotonic() - self._next_s
        if behind_s < 0:
            return 0
        if behind_s > MAX_BEHIND_S:
            self.restart()
            return 1
        beats = 1 + int(behind_s / self._period_s)
        self._next_s += beats * self._period_s
        return beats

    def wait_s(self) -> float:
        """Return the time until the next beat."""
        return max(self._next_s - time.monotonic(), 0.0)

    def restart(self) -> None:
        """Begin anew: the next beat is one period away."""
        self._next_s = time.monotonic() + self._period_s


class Plug(Protocol):
    """How a device is reached: a port, a listener."""

    def plug(self) -> None:
        """Be there; does nothing when it is."""

    def unplug(self) -> None:
        """Be gone, as a cable pulled out or a server stopped."""


class StandInServer(ABC):
    """Serves until ``quit``; the end of a piped input means quit, so no orphan stays.

    On standard input: ``fault NAME`` breaks it, ``fault none`` mends it, ``stats`` prints its counts.

    Args:
        plug: what the faults ``unplug`` and ``stop`` take away.
        address: where it is; printed once it is ready.
        fault: what is broken from the start.

    Attributes:
        faults: names that may be set.
        fault: what is broken now; "none" when nothing is.

    Raises:
        ContractError: an unknown initial fault.
    """

    faults: ClassVar[tuple[str, ...]]

    def __init__(self, plug: Plug, address: str, fault: str) -> None:
        if fault not in ("none", *self.faults):
            known = " | ".join(("none", *self.faults))
            raise ContractError(expected("fault", known, fault, "Name one of them."))
        self.fault = fault
        self._plug, self._address = plug, address
        self._pending = b""
        self._quit = False

    def run(self) -> int:
        """Serve until told to quit; return the exit code."""
        listens = stat.S_ISFIFO(os.fstat(0).st_mode) or os.isatty(0)  # not to /dev/null, which ends at once
        _say(f"ready {self._address}")
        try:
            while not self._quit:
                reading, writing, wait_s = self.waits_for()
                ready, writable, _ = select.select([*reading, *([0] if listens else [])], writing, [], wait_s)
                if 0 in ready:
                    self._obey()
                self.serve([one for one in ready if one != 0], writable)
        except KeyboardInterrupt:
            return 0
        finally:
            self._plug.unplug()
        return 0

    @abstractmethod
    def waits_for(self) -> tuple[list[Any], list[Any], float]:
        """Return what to wait for: input on these, room on these, and for how long, s."""

    @abstractmethod
    def serve(self, ready: list[Any], writable: list[Any]) -> None:
        """Take what came, send what is due."""

    @abstractmethod
    def stats(self) -> str:
        """Return the counts, ``name=number`` each."""

    def on_fault(self) -> None:
        """Do what a new fault needs at once."""
        if self.fault in ("unplug", "stop"):
            self._plug.unplug()
        else:
            self._plug.plug()

    def _obey(self) -> None:
        chunk = os.read(0, READ_BYTES)
        self._quit = self._quit or not chunk
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        for line in lines:
            self._do(line.decode(errors="replace").split())

    def _do(self, words: list[str]) -> None:
        match words:
            case ["fault", name] if name in ("none", *self.faults):
                self.fault = name
                self.on_fault()
                _say(f"fault {name}")
            case ["stats"]:
                _say(f"stats {self.stats()}")
            case ["quit"]:
                self._quit = True
            case _:
                _say(f"unknown {' '.join(words)}; known: fault none | {' | '.join(self.faults)}, stats, quit")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
