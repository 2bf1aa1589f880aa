"""A hand on a clock that is set or the machine's own, for whatever owns a ``Hand``."""

import time

import numpy as np

from uniforce_vtla.errors import RobotError
from uniforce_vtla.hand import HandReading


class FakeHand:
    """Takes a while for each command; keeps what it was asked, and whether two ever overlapped.

    ``moves``: its fingers go at their speed and close on an object of ``object_m``; else they are
    there at the end.
    """

    def __init__(self, takes_s=0.1, clock=time.monotonic, moves=False):
        self.takes_s, self.clock, self.moves = takes_s, clock, moves
        self.width_m, self.max_width_m, self.object_m = 0.08, 0.08, 0.0
        self.commands = []
        self.overlaps = self.stops = 0
        self.fault = None
        self.closed = False
        self.is_grasped = self.closed_by_hand = False
        self.silent_since_s = None  # readings repeat from then on
        self._ends_s = None
        self._outcome = None
        self._looked_s = 0.0

    def connect(self):
        if self.fault is not None:
            raise self.fault

    def begin(self, command):
        self.overlaps += self._ends_s is not None
        self.commands.append(command)
        self.is_grasped &= not self.moves
        goal_m = self._goal_m(command)
        takes_s = abs(goal_m - self.width_m) / command.speed_m_s if self.moves else self.takes_s
        self._looked_s = self.clock()
        self._ends_s = self._looked_s + takes_s

    def _goal_m(self, command):
        if not self.moves:
            return command.width_m
        closes_on_m = self.object_m if self.width_m >= self.object_m else 0.0
        return max(0.0 if command.force_N else command.width_m, closes_on_m)

    def stop(self):
        self.advance()
        self.stops += 1
        if self._ends_s is not None:
            self._ends_s, self._outcome = None, False

    def advance(self):
        """Let the fingers go as far as the time since the last look allows."""
        now_s, command = self.clock(), self.commands[-1] if self.commands else None
        elapsed_s, self._looked_s = now_s - self._looked_s, now_s
        if command is None or self._ends_s is None:
            return
        if self.moves:
            step_m = command.speed_m_s * elapsed_s
            self.width_m += float(np.clip(self._goal_m(command) - self.width_m, -step_m, step_m))
        if now_s < self._ends_s:
            return
        self.width_m, self._ends_s, self._outcome = self._goal_m(command), None, True
        if self.moves and command.force_N:
            self.is_grasped = self._outcome = 0 < self.object_m == self.width_m

    def poll(self):
        self.advance()
        outcome, self._outcome = self._outcome, None
        return outcome

    def refuse_closed(self):
        if self.closed_by_hand:
            raise RobotError("closed", "hand_connection")

    def read(self):
        if self.fault is not None:
            raise self.fault
        self.advance()
        now_s = self.clock() if self.silent_since_s is None else self.silent_since_s
        return HandReading(now_s, self.width_m, self.max_width_m, self.is_grasped)

    def close(self):
        self.closed = True
