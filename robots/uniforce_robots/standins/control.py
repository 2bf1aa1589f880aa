"""Base of every stand-in: keep a rate, break on command, obey lines on standard input."""

import os
import select
import stat
import sys
import time
from typing import Any, ClassVar

import numpy as np

from uniforce_robots.standins.plugs import READ_BYTES, PseudoTerminal, Sockets
from uniforce_vtla.errors import require_one_of

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
        if behind_s < 0:
            return 0
        beats = 1 + int(behind_s / self._period_s)
        self._next_s += beats * self._period_s
        return beats

    def wait_s(self) -> float:
        """Return the time until the next beat."""
        return max(self._next_s - time.monotonic(), 0.0)

    def restart(self) -> None:
        """Begin anew: the next beat is one period away."""
        self._next_s = time.monotonic() + self._period_s


class InputLines:
    """Lines on standard input: a person's, or a program's pipe, whose end means quit."""

    def __init__(self) -> None:
        # not from /dev/null, which ends at once
        self.files = [0] if stat.S_ISFIFO(os.fstat(0).st_mode) or os.isatty(0) else []
        self.ended = False
        self._pending = b""

    def read(self) -> list[str]:
        """Return the whole lines that came; blocks where nothing waits."""
        chunk = os.read(0, READ_BYTES)
        self.ended = not chunk
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        return [line.decode(errors="replace") for line in lines]


class StandInServer:
    """Prints ``ready ADDRESS`` and serves until its input ends.

    On standard input: ``fault NAME`` breaks it, ``fault none`` mends it, ``stats`` prints how much
    it sent.

    Clients reach it by ``plug``, at ``address``; the faults ``unplug`` and ``stop`` take it away.
    ``config.fault``, one of ``faults`` or "none", is there from the start. ``rate_hz`` is that of
    its beats.
    """

    faults: ClassVar[tuple[str, ...]]

    def __init__(
        self, plug: PseudoTerminal | Sockets, address: str, config: Any, rate_hz: float
    ) -> None:
        require_one_of("fault", config.fault, ("none", *self.faults))
        self.plug = plug
        self.address = address
        self.config = config
        self.fault = config.fault
        self.pace = Pace(rate_hz)
        self.rng = np.random.default_rng(config.seed)
        self._step = -1
        self._input = InputLines()

    def run(self) -> int:
        """Serve until the input ends, or Ctrl-C; return the exit code."""
        self.on_fault()
        say(f"ready {self.address}")
        try:
            while not self._input.ended:
                reading, writing = self.plug.waits_for()
                ready, _, _ = select.select(
                    [*reading, *self._input.files], writing, [], self.pace.wait_s()
                )
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

    def answer(self, received: bytes) -> None:
        """Answer what a client sent; most devices are only read."""

    def next_step(self) -> int:
        """Return the place in a cycle of signals to show now; the fault ``freeze`` stays at it."""
        self._step += self.fault != "freeze"
        return self._step

    def on_fault(self) -> None:
        """Do what a new fault needs at once."""
        if self.fault in ("unplug", "stop"):
            self.plug.unplug()
        else:
            self.plug.plug()

    def _obey(self) -> None:
        for line in self._input.read():
            match line.split():
                case ["fault", name] if name in ("none", *self.faults):
                    self.fault = name
                    self.on_fault()
                    say(f"fault {name}")
                case ["stats"]:
                    say(f"stats sent={self.plug.sent}")
                case words:
                    known = " | ".join(self.faults)
                    say(f"unknown {' '.join(words)}; known: fault none | {known}, stats")


def say(line: str) -> None:
    """Print a line at once: a program may wait for it."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
