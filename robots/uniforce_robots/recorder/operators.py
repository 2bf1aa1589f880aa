"""Operators begin an episode and judge it: a person at the keys or a rule; and the display."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TextIO

import numpy as np

from uniforce_robots.recorder.rig import Observation
from uniforce_robots.teleop.keyboard import TerminalKeys
from uniforce_vtla.errors import ContractError, expected, require_one_of
from uniforce_vtla.evaluation.episode import ScoreLimits


class Phase(Enum):
    """Where the session stands."""

    WAITING = "waiting"  # between episodes, nothing is recorded
    RUNNING = "running"
    PAUSED = "paused"
    JUDGING = "judging"  # the episode is over and waits for its verdict


class Command(Enum):
    """Orders of an operator, by key: letters that no keyboard teleoperator uses."""

    GO = "space"  # begin; pause; go on
    HOLD = "esc"  # hold, in every phase; also the end of a note that is dropped
    SUCCESS = "y"  # a clean one: no slip, no excess force
    RESIDUAL = "f"  # failed: not wiped
    FAILED_GRASP = "g"
    DISCARD = "x"  # forget this episode
    RERECORD = "r"  # forget it and record the same one at once
    NOTE = "t"  # hold; its text follows, up to Enter
    RECOVER = "v"  # clear the robot's fault; steer again between episodes
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
    note: str | None = None  # what is typed of one so far; None: none is open

    def start(self) -> None:
        """Begin to read."""

    def poll(self, phase: Phase) -> list[Event]:
        """Return what was ordered since the last call. Never blocks."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stop reading; safe to call twice."""


class Unattended(Operator):
    """Begin at once, and give every episode that ended in time the same verdict.

    Raises ContractError: another verdict than ``VERDICTS``.
    """

    is_attended = False

    def __init__(self, verdict: str) -> None:
        require_one_of("verdict", verdict, VERDICTS.values())
        self._orders = {phase: Command.GO for phase in (Phase.WAITING, Phase.PAUSED)}
        self._orders[Phase.JUDGING] = Command[verdict.upper()]

    def poll(self, phase: Phase) -> list[Event]:
        """Begin where there is waiting, judge where judging is due."""
        if phase in self._orders:
            return [Event(self._orders[phase])]
        return []


NOTE_S = 30.0  # without a key, after which a note ends


class KeyOperator(Operator):
    """A person at a keyboard; digits 1, 2, … add one of ``quick_notes``.

    ``t`` holds the arm and begins a note: meanwhile letters neither steer nor command. Enter ends
    it, Escape drops it. It ends by itself where no key came for long, or the episode goes on or is
    to be judged.

    ``keys`` are those of a keyboard teleoperator that reads this terminal; None reads it here.
    """

    def __init__(self, keys: TerminalKeys | None = None, quick_notes: Sequence[str] = ()) -> None:
        self._is_own = keys is None
        self._keys = keys or TerminalKeys({})
        self._keys.text_begins = Command.NOTE.value
        self._meanings = {c.value: Event(c) for c in Command if c is not Command.NOTE}
        for number, note in enumerate(quick_notes, 1):
            self._meanings[str(number)] = Event(Command.NOTE, note)
        self._phase = Phase.WAITING
        self._typed_s = 0.0

    def start(self) -> None:
        """Read the terminal; raises ContractError where there is none."""
        if self._is_own and not sys.stdin.isatty():
            do = "Run it in a terminal, or choose operator=unattended."
            raise ContractError(expected("operator=keys", "a terminal", "another input", do))
        if self._is_own:
            self._keys.start()

    def poll(self, phase: Phase) -> list[Event]:
        """Return what the keys since the last call mean."""
        pressed = self._keys.take_others()
        now_s = self._keys.clock()
        goes_on = phase is not self._phase and phase in (Phase.RUNNING, Phase.JUDGING)
        is_left = not pressed and now_s - self._typed_s > NOTE_S
        events = []
        if self.note is not None and (goes_on or is_left):
            events.append(self._end_note())
        for key in pressed:
            events.append(self._meaning(key))
            self._typed_s = now_s
        self._phase = phase
        return [event for event in events if event is not None]

    def stop(self) -> None:
        """Stop reading."""
        if self._is_own:
            self._keys.stop()

    def _meaning(self, key: str) -> Event | None:
        if self.note is None:
            if key == Command.NOTE.value:
                self.note = ""
                key = Command.HOLD.value
            return self._meanings.get(key.lower())
        if key == "enter":
            return self._end_note()
        if key == "esc":
            self.note = None
            return self._meanings[key]
        if key == "backspace":
            self.note = self.note[:-1]
        elif key == "space":
            self.note += " "
        elif len(key) == 1:
            self.note += key
        return None

    def _end_note(self) -> Event | None:
        note, self.note, self._keys.is_text = self.note, None, False
        return Event(Command.NOTE, note) if note else None


LINE_EVERY_s = 0.2  # a person reads no faster
BAR = 20  # characters
# above them a score has excess force
WARN_N = ScoreLimits.mean_press_N
STOP_N = ScoreLimits.peak_press_N


class LiveView:
    """Write one line over and over on a terminal, and lasting lines; nothing without ``out``.

    ``peak_N`` is the largest force of the episode so far.
    """

    def __init__(self, out: TextIO | None, fps: int = 30) -> None:
        self._out = out
        self._fps = fps
        self._moves = out is not None and out.isatty()  # a line can be written over
        self._next_s = self.peak_N = 0.0
        self._mode = ""  # shown last

    def begin(self, text: str) -> None:
        """Begin an episode: its peak force is forgotten."""
        self.peak_N = 0.0
        self.say(text)

    def say(self, text: str) -> None:
        """Write a line that stays."""
        self._mode = ""
        self._write(f"\r\x1b[K{text}\n" if self._moves else f"{text}\n")

    def show_note(self, phase: Phase, note: str | None) -> None:
        """Show the phase, or the note typed so far, on a terminal when they change."""
        mode = phase.value
        if note is not None:
            mode = f"note (Enter ends it, Escape drops it): {note[-60:]}_"
        if self._moves and mode != self._mode:
            self._mode = mode
            self._write(f"\r\x1b[K{mode}")

    def show(self, seen: Observation, frames: int) -> None:
        """Show an observation, five times a second on a terminal, never elsewhere."""
        self.peak_N = max(self.peak_N, float(np.linalg.norm(seen.force_N)))
        now_s = time.perf_counter()
        if self._moves and now_s >= self._next_s:
            self._next_s = now_s + LINE_EVERY_s
            self._mode = ""
            self._write("\r\x1b[K" + self.line(seen, frames))

    def _write(self, text: str) -> None:
        if self._out is not None:
            try:
                self._out.write(text)
                self._out.flush()
            except OSError:  # the terminal hung up: no episode ends for want of a reader
                self._out = None
                self._moves = False

    def line(self, seen: Observation, frames: int) -> str:
        """Return the line: time, force as a bar up to its limit, peak, width, oldest sensor."""
        force_N = float(np.linalg.norm(seen.force_N))
        filled = min(round(BAR * force_N / STOP_N), BAR)
        mark = "  "
        if force_N > STOP_N:
            mark = "!!"
        elif force_N > WARN_N:
            mark = "! "
        oldest, sample = min(seen.samples.items(), key=lambda named: named[1].time_s)
        age_ms = 1000 * (seen.time_s - sample.time_s)
        return (
            f"{Phase.RUNNING.value} {frames / self._fps:5.1f} s"
            f"  force [{'#' * filled}{'.' * (BAR - filled)}] {force_N:4.1f} N {mark}"
            f"peak {self.peak_N:4.1f} of {STOP_N:g}  width {1000 * seen.axes[4]:4.1f} mm"
            f"  oldest {oldest} {age_ms:.0f} ms"
        )
