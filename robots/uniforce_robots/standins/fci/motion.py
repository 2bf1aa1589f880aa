"""A Move under way: its newest command, what it missed, what it broke."""

from __future__ import annotations

from dataclasses import dataclass

from uniforce_robots.standins.fci.arm import Arm
from uniforce_robots.standins.fci.protocol import ErrorBit, MoveRequest, RobotCommand
from uniforce_robots.standins.fci.rules import broken_rules

MISSES_ALLOWED = 20  # FCI: as many lost packets in a row end the motion


@dataclass
class Motion:
    """A Move under way."""

    command_id: int
    request: MoveRequest
    command: RobotCommand | None = None  # the newest
    answered: bool = False  # whether the last state has got its command
    misses: int = 0  # in a row
    broken: frozenset[int] = frozenset()  # rules, by commands that wait to be followed

    def take(self, command: RobotCommand, arm: Arm, now_ms: int, rules: bool) -> None:
        """Make a command the newest."""
        if rules:
            self.broken |= broken_rules(command, self.command, self.request.generator, arm)
        self.command = command
        self.answered = command.message_id >= now_ms

    def count(self) -> None:
        """Count a millisecond that was answered or missed."""
        self.misses = 0 if self.answered else self.misses + 1

    def lost(self, miss_rule: bool) -> frozenset[int]:
        """Return the error bit of too many missed commands in a row."""
        too_many = miss_rule and self.misses >= MISSES_ALLOWED
        return frozenset({ErrorBit.COMMUNICATION_CONSTRAINTS_VIOLATION} if too_many else ())
