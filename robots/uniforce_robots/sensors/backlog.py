"""Catching up: data that waited in the kernel must not pass for new.

Whoever reads full buffers goes on reading until one isn't full, and only then stamps and delivers: meanwhile the newest
sample grows old, as it should.  A reader that never catches up is an error.
"""

from __future__ import annotations

import time

from uniforce_robots.sensors.faults import StaleSensorError
from uniforce_vtla.errors import expected

MAX_BEHIND_S = 1.0


class Backlog:
    """Tells whether to read on, and raises once that goes on for too long.

    Args:
        name: how errors call the sensor.
        full_bytes: a read of so many bytes means that more is waiting.
        max_behind_s: how long that may go on.
    """

    def __init__(self, name: str, full_bytes: int, max_behind_s: float = MAX_BEHIND_S) -> None:
        self._name, self._full, self._max_s = name, full_bytes, max_behind_s
        self._since_s: float | None = None

    def more_waits(self, size: int) -> bool:
        """Return whether a read of ``size`` bytes was full, so that there is more to read at once.

        Raises:
            StaleSensorError: full reads only, for longer than allowed.
        """
        now_s = time.monotonic()
        if size < self._full:
            self._since_s = None
            return False
        if self._since_s is None:
            self._since_s = now_s
        behind_s = now_s - self._since_s
        if behind_s > self._max_s:
            self._since_s = None
            do = "Free the CPU of this machine; what waited is thrown away by opening anew."
            came = f"a queue for {behind_s:.2f} s"
            raise StaleSensorError(expected(self._name, "a reader that keeps up", came, do))
        return True
