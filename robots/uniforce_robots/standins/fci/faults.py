"""Begins and ends the ordered fault on the robot's own clock, and remembers when."""

from __future__ import annotations

import math
import time

from uniforce_robots.standins.fci.arm_service import ArmService
from uniforce_robots.standins.fci.hand_service import HandService
from uniforce_robots.standins.fci.hostile import FAULTS, NONE
from uniforce_robots.standins.fci.journal import Journal


class Faults:
    """One fault at a time: ordered, begun, lasting, ended."""

    def __init__(self, arm: ArmService, hand: HandService, journal: Journal) -> None:
        self.arm, self.hand, self.journal = arm, hand, journal
        self.name = NONE  # the one that lasts
        self._last: dict[str, object] = {"last": NONE, "at_ms": None, "at_s": None}
        self._ordered: str | None = None  # not begun yet
        self._begin_ms = self._end_ms = self._duration_ms = math.inf

    def order(self, name: str, after_ms: float = 0, duration_ms: float | None = None) -> None:
        """End the fault that lasts, and begin another after some of the robot's milliseconds.

        Raises:
            ValueError: no such fault, or a time that is negative or no number.
        """
        if name != NONE and name not in FAULTS:
            raise ValueError(f"fault: expected {NONE} or one of {sorted(FAULTS)}, got {name!r}")
        duration = math.inf if duration_ms is None else float(duration_ms)
        if not (0 <= after_ms < math.inf and duration > 0):
            raise ValueError(f"fault times: expected ≥ 0 and > 0 ms, got {after_ms} and {duration_ms}")
        self._end()
        if name != NONE:
            self._ordered, self._duration_ms = name, duration
            self._begin_ms = self.arm.milliseconds + after_ms
            self._begin_if_due()

    def tick(self) -> None:
        """Do what is due in this millisecond."""
        self._begin_if_due()
        if self.name != NONE:
            FAULTS[self.name].watch(self.arm, self.hand)
            if self.arm.milliseconds >= self._end_ms:
                self._end()

    def describe(self) -> dict[str, object]:
        """Return the fault that lasts, and when the last one began: the robot's time and CLOCK_MONOTONIC."""
        return {"name": self.name, **self._last}

    def _begin_if_due(self) -> None:
        if self._ordered is None or self.arm.milliseconds < self._begin_ms:
            return
        self.name, self._ordered = self._ordered, None
        now_ms = self.arm.milliseconds
        self._end_ms = now_ms + self._duration_ms
        self._last = {"last": self.name, "at_ms": now_ms, "at_s": time.monotonic()}
        self.journal.write("fault", name=self.name, milliseconds=now_ms)
        FAULTS[self.name].begin(self.arm, self.hand)

    def _end(self) -> None:
        self._ordered = None
        if self.name == NONE:
            return
        fault, self.name = FAULTS[self.name], NONE
        self.arm.mend()
        self.hand.mend()
        fault.end(self.arm, self.hand)
        self.journal.write("fault", name=NONE, milliseconds=self.arm.milliseconds)
