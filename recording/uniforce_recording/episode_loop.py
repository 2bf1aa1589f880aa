"""One episode: tick by tick observe, steer, act, store. Whatever ends it, the rig holds first and people hear later."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

from uniforce_recording.disk_guard import DiskGuard
from uniforce_recording.ending import Ending, How
from uniforce_recording.faults import StopRequestedError, cause_of
from uniforce_recording.frame_count import FrameCount
from uniforce_recording.interrupts import Interrupts
from uniforce_recording.live_view import LiveView
from uniforce_recording.operators import VERDICTS, Command, Event, Operator, Phase
from uniforce_recording.rig import Rig
from uniforce_recording.rows import make_row, raw_frames
from uniforce_recording.steering import Steering
from uniforce_recording.store import Store
from uniforce_recording.ticker import Ticker
from uniforce_vtla.errors import TeleoperatorError, UniForceError


@dataclass
class Parts:
    """What an episode needs, shared by all of a session."""

    rig: Rig
    steering: Steering
    operator: Operator
    recorder: Store
    disk: DiskGuard
    view: LiveView
    interrupts: Interrupts = field(default_factory=Interrupts)

    def refuse_interrupted(self) -> None:
        """Raise StopRequestedError once somebody asked the program to end."""
        if self.interrupts.count:
            raise StopRequestedError("interrupted by Ctrl-C")


class _Over(Exception):  # noqa: N818  not an error: a person's word, from wherever in the tick it is heard
    def __init__(self, how: How, **more: Any) -> None:
        super().__init__(how)
        self.how, self.more = how, more


class EpisodeLoop:
    """Run one episode of at most ``max_frames`` rows; their storing is the session's business.

    Args:
        parts: the session's.
        prompt: the instruction every row is stored with.
        max_frames: the time limit.
    """

    def __init__(self, parts: Parts, prompt: str, max_frames: int) -> None:
        self._parts, self._prompt, self._max_frames = parts, prompt, max_frames
        self._ticker = Ticker(parts.rig.facts.fps, parts.rig.facts.paced)
        self._frames = FrameCount()
        self._notes: list[str] = []
        self._pauses = 0
        self._tick_begun_s = time.perf_counter()

    def run(self) -> Ending:
        """Record until somebody or something ends it; never raises what an ``Ending`` can tell."""
        rig = self._parts.rig
        try:
            self._record()
        except _Over as over:
            rig.hold()
            return self._ending(over.how, **over.more)
        except UniForceError as error:
            rig.hold()
            return self._fault(error, time.perf_counter() - self._tick_begun_s)
        rig.hold()
        return self._ending("open")

    def _fault(self, error: UniForceError, held_s: float) -> Ending:
        if isinstance(error, TeleoperatorError) and error.fault == "ended":  # a replay that came to its end
            return self._ending("open", message=str(error))
        return self._ending("aborted", cause=cause_of(error), message=str(error), held_s=held_s)

    def _ending(self, how: How, **more: Any) -> Ending:
        notes, frames = tuple(self._notes), self._frames.as_dict()
        return Ending(how, self._ticker.stats, notes=notes, pauses=self._pauses, frames=frames, **more)

    def _record(self) -> None:
        parts = self._parts
        parts.steering.start_from(parts.rig.axes())
        begun_s = parts.rig.now_s()
        self._ticker.restart()
        for _ in range(self._max_frames):
            self._ticker.wait()
            self._tick_begun_s = time.perf_counter()
            self._listen()
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
        stamps_s = (tick_s, seen.time_s, parts.rig.now_s())
        row = make_row(seen, requested, sent, stamps_s, begun_s)
        parts.recorder.add(row, self._prompt, raw_frames(seen))
        self._frames.add(seen)
        parts.view.show(seen, parts.recorder.num_frames)

    def _listen(self) -> None:
        self._parts.refuse_interrupted()
        for event in self._parts.operator.poll(Phase.RUNNING):
            if event.command is Command.GO:
                self._pause()
            else:
                self._obey(event)

    def _obey(self, event: Event) -> None:
        match event.command:
            case Command.NOTE:
                self._notes.append(event.text)
            case Command.DISCARD:
                raise _Over("discard")
            case Command.RERECORD:
                raise _Over("rerecord")
            case Command.QUIT:
                raise _Over("discard", quits=True)
            case command if command in VERDICTS:
                outcome = VERDICTS[command]
                raise _Over("judged", outcome=outcome, clean=outcome == "success")

    def _pause(self) -> None:
        """Hold until told to go on; nothing is stored meanwhile, and the times of the rows show the gap."""
        parts, beat = self._parts, Ticker(self._parts.rig.facts.fps)
        self._pauses += 1
        parts.rig.hold()
        parts.view.say("paused; space goes on")
        paused = True
        while paused:
            beat.wait()
            self._tick_begun_s = time.perf_counter()
            parts.refuse_interrupted()
            parts.rig.axes()  # a fault of the robot ends a pause too
            for event in parts.operator.poll(Phase.PAUSED):
                if event.command is Command.GO:
                    paused = False
                else:
                    self._obey(event)
        parts.steering.start_from(parts.rig.axes())
        self._ticker.resume()
