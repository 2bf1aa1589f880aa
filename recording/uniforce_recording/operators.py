"""Who says when an episode begins and how it went: a person at the keys, nobody, or a script."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from lerobot.utils.keyboard_input import TerminalKeyListener

from uniforce_vtla.errors import ContractError, expected


class Phase(Enum):
    """Where the session stands."""

    WAITING = "waiting"  # between episodes, nothing is recorded
    RUNNING = "running"
    PAUSED = "paused"
    JUDGING = "judging"  # the episode is over, how it went is to be said


class Command(Enum):
    """What can be said."""

    GO = "go"  # begin; pause; go on
    SUCCESS = "success"  # a clean one: no slip, no excess force
    RESIDUAL = "residual"  # failed: not wiped
    FAILED_GRASP = "failed_grasp"
    DISCARD = "discard"  # forget this episode
    RERECORD = "rerecord"  # forget it and record the same one at once
    NOTE = "note"
    RECOVER = "recover"  # clear the robot's fault
    QUIT = "quit"


VERDICTS = {c: c.value for c in (Command.SUCCESS, Command.RESIDUAL, Command.FAILED_GRASP)}


@dataclass(frozen=True)
class Event:
    """A command; ``text`` is a note's."""

    command: Command
    text: str = ""


class Operator(Protocol):
    """Asked at every tick."""

    @property
    def is_attended(self) -> bool:
        """Whether a person can be waited for."""

    def start(self) -> None:
        """Begin to listen."""

    def poll(self, phase: Phase) -> list[Event]:
        """Return what was said since the last call. Never blocks."""

    def stop(self) -> None:
        """Stop listening; safe to call twice."""


class Nobody:
    """Unattended: begins at once, and calls every episode that ended in time by one verdict.

    Args:
        verdict: the outcome to store; a person can look at the videos later.
    """

    is_attended = False

    def __init__(self, verdict: str) -> None:
        known = {name: command for command, name in VERDICTS.items()}
        if verdict not in known:
            raise ContractError(expected("verdict", " | ".join(known), verdict, "Name one."))
        self._verdict = known[verdict]

    def start(self) -> None:
        """Nothing to listen to."""

    def poll(self, phase: Phase) -> list[Event]:
        """Begin where there is waiting, judge where judging is due."""
        answers = {Phase.WAITING: Command.GO, Phase.JUDGING: self._verdict, Phase.PAUSED: Command.GO}
        return [Event(answers[phase])] if phase in answers else []

    def stop(self) -> None:
        """Nothing to stop."""


# Letters that LeRobot's and our keyboard teleoperators don't steer with.
KEYS = {
    "space": Command.GO,
    "y": Command.SUCCESS,
    "f": Command.RESIDUAL,
    "g": Command.FAILED_GRASP,
    "x": Command.DISCARD,
    "r": Command.RERECORD,
    "v": Command.RECOVER,
    "q": Command.QUIT,
}
NOTE_KEY = "t"


class KeyReader(Protocol):
    """Where keys come from when something else reads this terminal already, e.g. a keyboard teleoperator's ``keys``."""

    def take_others(self) -> list[str]:
        """Return keys that mean nothing to the reader itself, and forget them."""


class TerminalKeySource:
    """Keys of this terminal, read by LeRobot's listener."""

    def __init__(self) -> None:
        self._keys: deque[str] = deque(maxlen=256)
        self._lock = threading.Lock()
        self._listener: TerminalKeyListener | None = None

    def start(self) -> None:
        """Read keys until ``stop``.

        Raises:
            ContractError: standard input is no terminal.
        """
        if not sys.stdin.isatty():
            do = "Run it in a terminal, or choose operator=nobody."
            raise ContractError(expected("operator=keys", "a terminal", "another input", do))
        self._listener = TerminalKeyListener(self.press)
        self._listener.start()

    def stop(self) -> None:
        """Give the terminal back."""
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.stop()

    def press(self, key: str) -> None:
        """Take a key; called by the listener's thread."""
        with self._lock:
            self._keys.append(key)

    def take_others(self) -> list[str]:
        """Return the keys pressed since the last call."""
        with self._lock:
            keys = list(self._keys)
            self._keys.clear()
        return keys


class KeyOperator:
    """A person at a keyboard; ``t`` begins a note, Enter ends it, digits add a prepared one.

    Args:
        reader: somebody else's reader of this terminal; None reads it here.
        quick_notes: what the digits 1, 2, … mean.
    """

    is_attended = True

    def __init__(self, reader: KeyReader | None = None, quick_notes: Sequence[str] = ()) -> None:
        self._own = TerminalKeySource() if reader is None else None
        self._reader: KeyReader = reader or self._own  # type: ignore[assignment]
        self._quick = {str(n): note for n, note in enumerate(quick_notes, 1)}
        self._note: str | None = None

    def start(self) -> None:
        """Listen; raises ContractError where there is no terminal."""
        if self._own is not None:
            self._own.start()

    def poll(self, phase: Phase) -> list[Event]:
        """Return what the keys since the last call mean."""
        events = [self._meaning(key) for key in self._reader.take_others()]
        return [event for event in events if event is not None]

    def stop(self) -> None:
        """Stop listening."""
        if self._own is not None:
            self._own.stop()

    def _meaning(self, key: str) -> Event | None:
        if self._note is not None:
            return self._spell(key)
        if key == NOTE_KEY:
            self._note = ""
            return None
        if key in self._quick:
            return Event(Command.NOTE, self._quick[key])
        return Event(KEYS[key]) if key in KEYS else None

    def _spell(self, key: str) -> Event | None:
        assert self._note is not None  # asked for by whom has looked
        if key == "enter":
            text, self._note = self._note, None
            return Event(Command.NOTE, text) if text else None
        if key == "backspace":
            self._note = self._note[:-1]
        elif len(key) == 1 or key == "space":
            self._note += " " if key == "space" else key
        return None


class Script:
    """Says what a function says; for tests and trials.

    Args:
        say: gets the phase and how often it was asked in this phase's stretch, returns commands or events.
        attended: whether to be waited for.
    """

    def __init__(self, say: Callable[[Phase, int], Sequence[Command | Event]], attended: bool = True) -> None:
        self._say, self.is_attended = say, attended
        self._phase: Phase | None = None
        self._asked = 0

    def start(self) -> None:
        """Nothing to start."""

    def poll(self, phase: Phase) -> list[Event]:
        """Return the script's words."""
        self._asked = self._asked + 1 if phase == self._phase else 0
        self._phase = phase
        said = self._say(phase, self._asked)
        return [event if isinstance(event, Event) else Event(event) for event in said]

    def stop(self) -> None:
        """Nothing to stop."""
