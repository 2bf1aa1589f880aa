"""A line that brings garbage between good samples: a few bytes are a bad plug, many are a sensor not to be trusted."""

from __future__ import annotations

from collections import deque

from uniforce_vtla.errors import SensorError, expected

OVER_s = 1.0
MOST = 5  # bad pieces in that time; a driver drops each and goes on, so the rate falls and nothing else shows


class GarbageWatch:
    """Watches a driver's count of pieces it could not understand."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._seen: deque[tuple[float, int]] = deque()

    def look(self, now_s: float, bad: int) -> None:
        """Take the count so far.

        Raises:
            SensorError: more than ``MOST`` came within the last second.
        """
        self._seen.append((now_s, bad))
        while now_s - self._seen[0][0] > OVER_s:
            self._seen.popleft()
        came = bad - self._seen[0][1]
        if came > MOST:
            do = "Check cable, power and what else is on the bus."
            raise SensorError(expected(self._name, f"≤ {MOST} bad pieces in {OVER_s:g} s", f"{came}", do))
