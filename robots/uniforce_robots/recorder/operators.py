"""What begins an episode and judges it: a person at the keys, or a fixed rule."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from uniforce_robots.teleop.keyboard import TerminalKeys
from uniforce_vtla.errors import ContractError, expected


class Phase(Enum):
    """Where the session stands."""

    WAITING = "waiting"  # between episodes, nothing is recorded
    RUNNING = "running"
    PAUSED = "paused"
    JUDGING = "judging"  # the episode is over and waits for its verdict


class Command(Enum):
    """What an operator can order, by its key: a letter that LeRobot's and our keyboard teleoperators don't use."""

    GO = "space"  # begin; pause; go on
    SUCCESS = "y"  # a clean one: no slip, no excess force
    RESIDUAL = "f"  # failed: not wiped
    FAILED_GRASP = "g"
    DISCARD = "x"  # forget this episode
    RERECORD = "r"  # forget it and record the same one at once
    NOTE = "t"  # its text follows, up to Enter
    RECOVER = "v"  # clear the robot's fault
    QUIT = "q"


VERDICTS = {c: c.name.lower() for c in (Command.SUCCESS, Command.RESIDUAL, Command.FAILED_GRASP)}


@dataclass(frozen=True)
class Event:
    """A command; ``text`` is a note's."""

    command: Command
    text: str = ""


class Operator:
    """Asked at every tick; ``is_attended`` says whether a person can be waited for."""

    is_attended = True

    def start(self) -> None:
        """Begin to read."""

    def poll(self, phase: Phase) -> list[Event]:
        """Return what was ordered since the last call. Never blocks."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stop reading; safe to call twice."""


class Unattended(Operator):
    """Begins at once, and gives every episode that ended in time the same verdict; a person can look at it later.

    Raises ContractError: another verdict than ``VERDICTS``.
    """

    is_attended = False

    def __init__(self, verdict: str) -> None:
        if verdict not in VERDICTS.values():
            raise ContractError(expected("verdict", " | ".join(VERDICTS.values()), verdict, "Name one."))
        self._orders = {phase: Command.GO for phase in (Phase.WAITING, Phase.PAUSED)}
        self._orders[Phase.JUDGING] = Command[verdict.upper()]

    def poll(self, phase: Phase) -> list[Event]:
        """Begin where there is waiting, judge where judging is due."""
        return [Event(self._orders[phase])] if phase in self._orders else []


class KeyOperator(Operator):
    """A person at a keyboard; ``t`` begins a note, Enter ends it, digits 1, 2, … add one of ``quick_notes``.

    ``keys`` are those of a keyboard teleoperator, which reads this terminal already; None reads it here.
    """

    def __init__(self, keys: TerminalKeys | None = None, quick_notes: Sequence[str] = ()) -> None:
        self._is_own, self._keys = keys is None, keys or TerminalKeys({})
        self._meanings = {c.value: Event(c) for c in Command if c is not Command.NOTE}
        self._meanings |= {str(n): Event(Command.NOTE, note) for n, note in enumerate(quick_notes, 1)}
        self._note: str | None = None

    def start(self) -> None:
        """Read the terminal; raises ContractError where there is none."""
        if self._is_own and not sys.stdin.isatty():
            do = "Run it in a terminal, or choose operator=unattended."
            raise ContractError(expected("operator=keys", "a terminal", "another input", do))
        if self._is_own:
            self._keys.start()

    def poll(self, phase: Phase) -> list[Event]:
        """Return what the keys since the last call mean."""
        events = [self._meaning(key) for key in self._keys.take_others()]
        return [event for event in events if event is not None]

    def stop(self) -> None:
        """Stop reading."""
        if self._is_own:
            self._keys.stop()

    def _meaning(self, key: str) -> Event | None:
        note = self._note
        if note is None:
            self._note = "" if key == Command.NOTE.value else None
            return self._meanings.get(key)
        if key == "enter":
            self._note = None
            return Event(Command.NOTE, note) if note else None
        if key == "backspace":
            self._note = note[:-1]
        elif len(key) == 1 or key == "space":
            self._note = note + (" " if key == "space" else key)
        return None
