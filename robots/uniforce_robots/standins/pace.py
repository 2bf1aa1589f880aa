"""Keeps a rate without drifting: what is late is sent at once, what was missed for long is skipped."""

from __future__ import annotations

import time

MAX_BEHIND_S = 0.25  # after a longer gap (a stopped process, a stall) the past is left out


class Pace:
    """Tells how many beats of ``rate_hz`` are due."""

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
