"""One episode: observe, steer, act, store at each tick. Whatever ends it, the rig holds first."""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_robots.recorder.disk_guard import DiskGuard
from uniforce_robots.recorder.faults import Interrupts, StopRequestedError, cause_of
from uniforce_robots.recorder.operators import VERDICTS, Command, Event, LiveView, Operator, Phase
from uniforce_robots.recorder.rig import Rig
from uniforce_robots.recorder.rows import make_row, raw_frames
from uniforce_robots.recorder.steering import Steering
from uniforce_robots.recorder.store import StoreProcess
from uniforce_robots.recorder.ticker import Ticker, TickStats
from uniforce_vtla.errors import TeleoperatorError, UniForceError, expected

log = logging.getLogger(__name__)
Store = EpisodeRecorder | StoreProcess


@dataclass(frozen=True)
class Parts:
    """Parts that all episodes of a session share."""

    rig: Rig
    steering: Steering
    operator: Operator
    recorder: Store
    disk: DiskGuard
    view: LiveView
    interrupts: Interrupts

    def refuse_interrupted(self) -> None:
        """Raise StopRequestedError once the program is to end."""
        if self.interrupts.count:
            raise StopRequestedError("interrupted by Ctrl-C")

    def events(self, phase: Phase) -> Iterator[list[Event]]:
        """Yield the operator's orders once a tick; raise StopRequestedError: the program ends."""
        beat = Ticker(self.rig.facts.fps)
        while True:
            beat.wait()
            self.refuse_interrupted()
            events = self.operator.poll(phase)
            self.view.show_note(phase, self.operator.note)
            yield events


@dataclass(frozen=True)
class Ending:
    """How an episode ended."""

    ticks: TickStats  # how the beat was kept
    # open: over, still to be judged; the last two are what the operator asked for
    how: Literal["judged", "open", "aborted", "discard", "rerecord"] = "open"
    outcome: str = "aborted"  # one of ``keys.OUTCOME_NAMES``; means something where judged
    clean: bool = False  # whether it was a success without slip or excess force
    cause: str = "none"  # where aborted, one of ``keys.ABORT_CAUSES``
    message: str = ""  # what happened, in words
    # from the beginning of the tick that met a fault until the rig was held; 0: no fault
    held_s: float = 0.0
    notes: tuple[str, ...] = ()  # what the operator wrote
    pauses: int = 0  # how often it was paused
    quits: bool = False  # whether the session shall end after it

    @property
    def label(self) -> str:
        """The ending in a word, e.g. ``success`` or ``aborted:stale_touch``."""
        if self.how == "aborted":
            return f"aborted:{self.cause}"
        if self.how == "judged":
            return self.outcome
        return self.how


# attributes of the ``Ending`` that an operator's command makes
ENDINGS: dict[Command, dict[str, Any]] = {
    Command.DISCARD: {"how": "discard"},
    Command.QUIT: {"how": "discard", "quits": True},
    Command.RERECORD: {"how": "rerecord"},
    **{
        c: {"how": "judged", "outcome": o, "clean": c is Command.SUCCESS}
        for c, o in VERDICTS.items()
    },
}


class _Over(Exception):  # noqa: N818  an operator's command, from anywhere in a tick
    def __init__(self, ending: dict[str, Any]) -> None:
        super().__init__(ending["how"])
        self.ending = ending


class EpisodeLoop:
    """Run one episode of at most ``max_frames`` rows, each with ``prompt``; don't save it."""

    def __init__(self, parts: Parts, prompt: str, max_frames: int) -> None:
        self._parts = parts
        self._prompt = prompt
        self._max_frames = max_frames
        self._ticker = Ticker(parts.rig.facts.fps, parts.rig.facts.paced)
        self._notes: list[str] = []
        self._pauses = 0
        self._tick_begun_s = time.perf_counter()

    def run(self) -> Ending:
        """Record until a person or a fault ends it; never raises what an ``Ending`` can say."""
        ending: dict[str, Any] = {}
        fault: UniForceError | None = None
        try:
            self._record()
        except _Over as over:
            ending = over.ending
        except UniForceError as error:
            fault = error
        except Exception as error:  # a device may be anybody's code: what was recorded is kept
            log.exception("the episode is aborted")
            came = f"{type(error).__name__}: {error}"
            do = "Check the devices; the log has the place."
            fault = UniForceError(expected("episode", "no other error than known ones", came, do))
        self._parts.rig.hold()
        if fault is not None:
            held_s = time.perf_counter() - self._tick_begun_s
            ending = {
                "how": "aborted",
                "cause": cause_of(fault),
                "message": str(fault),
                "held_s": held_s,
            }
        return Ending(self._ticker.stats, notes=tuple(self._notes), pauses=self._pauses, **ending)

    def _record(self) -> None:
        parts = self._parts
        parts.steering.start_from(parts.rig.axes())
        begun_s = parts.rig.now_s()
        self._ticker = Ticker(parts.rig.facts.fps, parts.rig.facts.paced)
        for _ in range(self._max_frames):
            self._ticker.wait()
            self._tick_begun_s = time.perf_counter()
            parts.refuse_interrupted()
            events = parts.operator.poll(Phase.RUNNING)
            self._obey(events)
            if any(event.command in (Command.GO, Command.HOLD) for event in events):
                self._pause()
            parts.disk.check()
            self._tick(begun_s)
            if parts.rig.is_done:
                return

    def _tick(self, begun_s: float) -> None:
        parts = self._parts
        tick_s = parts.rig.now_s()
        seen = parts.rig.observe()
        requested = parts.steering.target(seen.axes)
        sent = parts.rig.act(requested)
        row = make_row(seen, requested, sent, (tick_s, seen.time_s, parts.rig.now_s()), begun_s)
        parts.recorder.add(row, self._prompt, raw_frames(seen))
        parts.view.show(seen, parts.recorder.num_frames)

    def _obey(self, events: list[Event]) -> None:
        self._notes += [event.text for event in events if event.command is Command.NOTE]
        for event in events:
            if event.command in ENDINGS:
                raise _Over(ENDINGS[event.command])

    def _pause(self) -> None:
        """Hold until a person goes on; nothing is stored meanwhile, and row times show the gap."""
        parts = self._parts
        self._pauses += 1
        parts.rig.hold()
        parts.view.say("paused; space goes on")
        for events in parts.events(Phase.PAUSED):
            self._tick_begun_s = time.perf_counter()
            axes = parts.rig.axes()  # a fault of the robot ends a pause too
            self._obey(events)
            if Command.GO in [event.command for event in events] and self._starts(axes):
                break
        self._ticker.resume()

    def _starts(self, axes: np.ndarray) -> bool:
        """Start to steer; return False, and say why, where the device must first come to rest."""
        try:
            self._parts.steering.start_from(axes)
        except TeleoperatorError as error:
            if error.fault != "far":
                raise
            self._parts.view.say(f"still paused: {error}")
            return False
        return True
