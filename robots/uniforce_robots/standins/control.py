"""How a stand-in is told what to break: lines on its standard input, answers on its standard output."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable

from uniforce_vtla.errors import ContractError, expected

READ_BYTES = 4096


class Control:
    """Reads ``fault NAME``, ``stats`` and ``quit``; the end of a piped input means quit, so no orphan stays.

    Args:
        faults: names that may be set.
        on_fault: called with the name when one is set.
        stats: returns what ``stats`` prints.
        initial: the fault to start with.

    Attributes:
        fault: what is broken now; "none" when nothing is.
        quit: whether to end.

    Raises:
        ContractError: an unknown initial fault.
    """

    def __init__(
        self,
        faults: tuple[str, ...],
        on_fault: Callable[[str], None],
        stats: Callable[[], str],
        initial: str = "none",
    ) -> None:
        self._faults = ("none", *faults)
        self._on_fault, self._stats = on_fault, stats
        self._pending = b""
        self.quit = False
        if initial not in self._faults:
            raise ContractError(expected("fault", " | ".join(self._faults), initial, "Name one of them."))
        self.fault = initial
        self._listens = stat.S_ISFIFO(os.fstat(0).st_mode) or os.isatty(
            0
        )  # not to /dev/null, which ends at once

    def ready(self, address: str) -> None:
        """Tell the one who started us where we are."""
        say(f"ready {address}")

    def inputs(self) -> list[int]:
        """Return what to select on: standard input, where somebody may speak."""
        return [0] if self._listens else []

    def read(self) -> None:
        """Take what came on standard input."""
        chunk = os.read(0, READ_BYTES)
        self.quit = self.quit or not chunk
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        for line in lines:
            self._do(line.decode(errors="replace").split())

    def _do(self, words: list[str]) -> None:
        match words:
            case ["fault", name] if name in self._faults:
                self.fault = name
                self._on_fault(name)
                say(f"fault {name}")
            case ["stats"]:
                say(f"stats {self._stats()}")
            case ["quit"]:
                self.quit = True
            case _:
                say(f"unknown {' '.join(words)}; known: fault {' | '.join(self._faults)}, stats, quit")


def say(line: str) -> None:
    """Write one line at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
