"""Notices a reader that can't keep up: data then waits in the kernel, and arrives looking newer than it is."""

from __future__ import annotations

import time

from lerobot_camera_uniforce.faults import StaleSensorError
from uniforce_vtla.errors import expected

MAX_BEHIND_S = 0.25


class Backlog:
    """Raises once every read has come back full for a while.

    Args:
        name: how errors call the sensor.
        full_bytes: a read of so many bytes means that more is waiting.
        max_behind_s: how long that may go on.
    """

    def __init__(self, name: str, full_bytes: int, max_behind_s: float = MAX_BEHIND_S) -> None:
        self._name, self._full, self._max_s = name, full_bytes, max_behind_s
        self._since_s: float | None = None

    def check(self, size: int) -> None:
        """Take note of a read of ``size`` bytes.

        Raises:
            StaleSensorError: full reads only, for longer than allowed.
        """
        now_s = time.monotonic()
        if size < self._full:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        elif now_s - self._since_s > self._max_s:
            behind_s, self._since_s = now_s - self._since_s, None
            do = "Free the CPU of this machine; what waited is thrown away by opening anew."
            raise StaleSensorError(
                expected(self._name, "a reader that keeps up", f"a queue for {behind_s:.2f} s", do)
            )
