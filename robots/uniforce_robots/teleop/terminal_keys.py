"""Keys of a terminal as short pulses of speed: a terminal says when a key goes down, never when it comes up.

LeRobot's ``TerminalKeyListener`` reads them. Held keys repeat, and each repetition renews the pulse; the motion ends
one pulse after the last one.
"""

from __future__ import annotations

import contextlib
import select
import sys
import termios
import threading
import time
from collections.abc import Mapping

import numpy as np
from lerobot.utils.keyboard_input import TerminalKeyListener

from uniforce_vtla.errors import TeleoperatorError, expected
from uniforce_vtla.keys import AXES

PULSE_S = 0.12  # longer than a keyboard's repeat period (30 to 40 ms), short enough to stop soon
OTHERS_KEPT = 64  # keys of other meaning that wait for somebody to take them


class TerminalKeys:
    """Turn keys into speeds of axes.

    Args:
        meanings: key → (axis index, direction −1 or 1).
    """

    def __init__(self, meanings: Mapping[str, tuple[int, int]]) -> None:
        self._meanings = dict(meanings)
        self._until_s: dict[str, float] = {}
        self._others: list[str] = []
        self._lock = threading.Lock()
        self._listener: TerminalKeyListener | None = None

    @property
    def is_listening(self) -> bool:
        """Whether keys are read."""
        return self._listener is not None

    def start(self) -> None:
        """Read keys from this terminal until ``stop``.

        Raises:
            TeleoperatorError: standard input is no terminal.
        """
        if not sys.stdin.isatty():
            do = "Run it in a terminal, not behind a pipe or in a notebook."
            raise TeleoperatorError(expected("keyboard", "a terminal", "another input", do), "connection")
        self._listener = TerminalKeyListener(self.press)
        self._listener.start()

    def stop(self) -> None:
        """Give the terminal back. Safe to call twice."""
        listener, self._listener = self._listener, None
        if listener is not None:
            with contextlib.suppress(termios.error):  # the terminal hung up: nothing left to restore
                listener.stop()

    def press(self, key: str) -> None:
        """Take one key; called by the listener's thread."""
        with self._lock:
            if key.lower() in self._meanings:
                self._until_s[key.lower()] = time.monotonic() + PULSE_S
            else:
                self._others = [*self._others, key][-OTHERS_KEPT:]

    def rates(self) -> np.ndarray:
        """(5,) direction of each axis now: −1, 0 or 1.

        Raises:
            TeleoperatorError: the terminal has gone.
        """
        self._check_terminal()
        rates = np.zeros(len(AXES))
        now = time.monotonic()
        with self._lock:
            for key, until in self._until_s.items():
                axis, direction = self._meanings[key]
                rates[axis] += direction * (now < until)
        return np.clip(rates, -1, 1)

    def forget(self) -> None:
        """Drop pulses that still run, so that an episode starts at rest."""
        with self._lock:
            self._until_s.clear()

    def take_others(self) -> list[str]:
        """Return keys that mean nothing here, e.g. a recorder's own, and forget them."""
        with self._lock:
            others, self._others = self._others, []
        return others

    def _check_terminal(self) -> None:
        poll = select.poll()
        poll.register(sys.stdin.fileno(), 0)
        if any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll(0)):
            do = "Start the program again."
            raise TeleoperatorError(expected("keyboard", "a terminal", "one that hung up", do), "connection")
