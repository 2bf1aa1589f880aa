"""What every stand-in shares: it keeps a rate, breaks on command, and obeys lines on its standard input."""

import os
import select
import stat
import sys
import time
from typing import Any, ClassVar

import numpy as np

from uniforce_robots.standins.plugs import READ_BYTES, PseudoTerminal, Sockets
from uniforce_vtla.errors import ContractError, expected

MAX_BEHIND_S = 0.25  # after a longer gap (a stopped process, a stall) the past is left out


class Pace:
    """Counts the beats of ``rate_hz`` that are due: late ones at once, none of a long gap."""

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._next_s = time.monotonic()

    def due(self) -> int:
        """Return the beats due now, and count them as done."""
        behind_s = time.monotonic() - self._next_s
        if behind_s > MAX_BEHIND_S:
            self.restart()
            return 1
        beats = 1 + int(behind_s / self._period_s) if behind_s >= 0 else 0
        self._next_s += beats * self._period_s
        return beats

    def wait_s(self) -> float:
        """Return the time until the next beat."""
        return max(self._next_s - time.monotonic(), 0.0)

    def restart(self) -> None:
        """Begin anew: the next beat is one period away."""
        self._next_s = time.monotonic() + self._period_s


class StandInServer:
    """Prints ``ready ADDRESS`` and serves until ``quit``; the end of a piped input means quit, so no orphan stays.

    On standard input: ``fault NAME`` breaks it, ``fault none`` mends it, ``stats`` prints its counts.

    Clients reach it by ``plug``, at ``address``; the faults ``unplug`` and ``stop`` take it away. ``config.fault``, one
    of ``faults`` or "none", is there from the start. ``rate_hz`` is that of its beats.
    """

    faults: ClassVar[tuple[str, ...]]

    def __init__(self, plug: PseudoTerminal | Sockets, address: str, config: Any, rate_hz: float) -> None:
        if config.fault not in ("none", *self.faults):
            known = " | ".join(("none", *self.faults))
            raise ContractError(expected("fault", known, config.fault, "Name one of them."))
        self.plug, self.address, self.config, self.fault = plug, address, config, config.fault
        self.pace, self.rng = Pace(rate_hz), np.random.default_rng(config.seed)
        self._step = -1
        self._pending = b""
        self._quit = False

    def run(self) -> int:
        """Serve until asked to quit; return the exit code."""
        listens = stat.S_ISFIFO(os.fstat(0).st_mode) or os.isatty(0)  # not to /dev/null, which ends at once
        self.on_fault()
        _say(f"ready {self.address}")
        try:
            while not self._quit:
                reading, writing = self.plug.waits_for()
                reading = [*reading, *([0] if listens else [])]
                ready, _, _ = select.select(reading, writing, [], self.pace.wait_s())
                if 0 in ready:
                    self._obey()
                if received := self.plug.receive(ready):
                    self.answer(received)
                for _ in range(self.pace.due()):
                    self.beat()
                self.plug.flush()
        except KeyboardInterrupt:
            return 0
        finally:
            self.plug.unplug()
        return 0

    def beat(self) -> None:
        """Send what is due; some devices only answer."""
        return

    def answer(self, received: bytes) -> None:
        """Answer what a client sent; most devices are only read."""
        return

    def next_step(self) -> int:
        """Return the place in a cycle of signals to show now; the fault ``freeze`` stays at it."""
        self._step += self.fault != "freeze"
        return self._step

    def on_fault(self) -> None:
        """Do what a new fault needs at once."""
        (self.plug.unplug if self.fault in ("unplug", "stop") else self.plug.plug)()

    def _obey(self) -> None:
        chunk = os.read(0, READ_BYTES)
        self._quit = self._quit or not chunk
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        for line in lines:
            match line.decode(errors="replace").split():
                case ["fault", name] if name in ("none", *self.faults):
                    self.fault = name
                    self.on_fault()
                    _say(f"fault {name}")
                case ["stats"]:
                    _say(f"stats sent={self.plug.sent} dropped={self.plug.dropped}")
                case ["quit"]:
                    self._quit = True
                case words:
                    known = " | ".join(self.faults)
                    _say(f"unknown {' '.join(words)}; known: fault none | {known}, stats, quit")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
