"""The recorder in a process of its own: whatever it takes to encode and store, no tick of the loop waits for it.

Python threads share one lock; with eight videos encoded in the loop's own process a tick takes 90 ms instead of 15.
Rows go through shared memory, orders and answers through a pipe. Where the loop's process dies, the pipe ends: what
was ordered is finished, the running episode is dropped, and the dataset is free for the next session.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from uniforce_datasets.features import dataset_features
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_recording.rig import RigFacts
from uniforce_recording.row_slots import RECORDERS_OWN, REFERENCES, RowSlots
from uniforce_recording.rows import further_columns
from uniforce_recording.store import StoreSettings, open_recorder
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import DatasetError, DroppedFrameError, UniForceError, expected

log = logging.getLogger(__name__)
SLOTS = 30  # rows on the way: a second of a busy child, some 4 MB each
WARM_UP_FRAMES = 3  # the first ones import, open and allocate for half a second
START_s = 120.0  # imports of LeRobot and torch on a starved machine
ANSWER_s = 180.0  # the longest save: LeRobot itself waits 120 s for an encoder
PATIENCE_s = 60.0  # how long a scene that isn't paced waits for a slot
NICE = 5  # the loop comes first


@dataclass(frozen=True)
class Standing:
    """What the child answers: how much is in the dataset."""

    episodes: int
    frames: int


class StoreProcess:
    """A ``Store`` whose work is done elsewhere. An error of ``add`` shows at a later call, at the latest at ``save``.

    The child starts in the background; the first question waits until it is ready, and raises what kept it from it.

    Args:
        facts: of the rig.
        settings: where to.

    """

    def __init__(self, facts: RigFacts, settings: StoreSettings) -> None:
        context = multiprocessing.get_context("spawn")  # never fork: threads of cameras and clients
        self._paced = facts.paced
        self._features = dataset_features(facts.cameras, facts.truth, further_columns(facts))
        self._slots = RowSlots(self._features, facts.raw_frames, SLOTS, context)
        self._free: deque[int] = deque(range(SLOTS))
        self._sent: dict[str, Any] = {}  # reference arrays the child has
        self._frames = 0
        self._standing: Standing | None = None  # until the child is ready
        self._pipe, other = context.Pipe()
        self._process = context.Process(
            target=serve, args=(other, self._slots, facts, settings), name="store", daemon=True
        )
        self._process.start()
        other.close()

    @property
    def pid(self) -> int:
        """Of the child, for whoever measures it."""
        return self._process.pid or 0

    @property
    def num_episodes(self) -> int:
        """Saved episodes."""
        return self._known().episodes

    @property
    def total_frames(self) -> int:
        """Frames of all saved episodes."""
        return self._known().frames

    @property
    def num_frames(self) -> int:
        """Frames of the running episode."""
        return self._frames

    @property
    def features(self) -> dict[str, dict]:
        """LeRobot's features dict of what is recorded."""
        return dict(self._features)

    def add(
        self, frame: Mapping[str, Any], task: str, raw: Mapping[Finger, np.ndarray] | None = None
    ) -> None:
        """Hand a row over; see ``EpisodeRecorder.add``.

        Raises:
            DroppedFrameError: the child is a second behind.
            DatasetError, ContractError: an earlier row could not be stored.
        """
        self._known()
        known = {key for key in REFERENCES if self._sent.get(key) is frame[key]}
        slot = self._take_slot()
        self._slots.write(slot, frame, raw or {}, known)
        self._sent |= {key: frame[key] for key in REFERENCES}
        self._send("add", slot, task, known)
        self._frames += 1

    def save(
        self,
        success: bool,
        outcome: str,
        seed: int,
        cause: str = "none",
        card: Mapping[str, Any] | None = None,
    ) -> None:
        """Make the episode durable; see ``EpisodeRecorder.save``. Waits until it is."""
        self._frames = 0
        self._send("save", success, outcome, seed, cause, card)
        self._await("standing", ANSWER_s)

    def discard(self) -> None:
        """Forget the running episode, and the error that broke it."""
        self._frames = 0
        self._send("discard")
        self._await("standing", ANSWER_s, forgive=True)

    def close(self) -> None:
        """Let the child finish and end; one that isn't ready yet has nothing to finish."""
        if self._standing is None:
            self._process.kill()
            self._process.join()
        if self._process.exitcode is None:
            try:
                self._send("close")
                self._process.join(ANSWER_s)
            except DatasetError as error:
                log.error("%s", error)
        if self._process.exitcode is None:
            log.error("the storing process doesn't end; it is killed, saved episodes are whole")
            self._process.kill()
            self._process.join()
        self._pipe.close()

    def __enter__(self) -> StoreProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _known(self) -> Standing:
        """Return how much is stored.

        Raises:
            DatasetError: as ``EpisodeRecorder`` when it is made, or the child doesn't start.
        """
        if self._standing is None:
            self._await("standing", START_s)
        assert self._standing is not None  # or _await has raised
        return self._standing

    # --- the pipe ----------------------------------------------------------------------------------------------------

    def _take_slot(self) -> int:
        self._hear_all()
        deadline_s = time.monotonic() + (0.0 if self._paced else PATIENCE_s)
        while not self._free:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                do = "The episode ends here: free the computer, or record smaller pictures."
                raise DroppedFrameError(expected("storing", f"≤ {SLOTS} frames behind", "more", do))
            if self._pipe.poll(min(left_s, 0.1)):
                self._hear_all()
        return self._free.popleft()

    def _hear_all(self) -> None:
        while self._pipe_has_more():
            self._take(*self._receive())

    def _pipe_has_more(self) -> bool:
        try:
            return self._pipe.poll(0)
        except OSError as error:
            raise self._gone() from error

    def _await(self, what: str, seconds: float, forgive: bool = False) -> None:
        deadline_s = time.monotonic() + seconds
        while True:
            if not self._pipe.poll(max(deadline_s - time.monotonic(), 0)):
                do = "The disk hangs? Saved episodes are whole."
                raise DatasetError(expected("storing", f"an answer within {seconds:g} s", "none", do))
            kind, content = self._receive()
            if kind == "error" and forgive:
                continue
            self._take(kind, content)
            if kind == what:
                return

    def _take(self, kind: str, content: Any) -> None:
        match kind:
            case "free":
                self._free.append(content)
            case "standing":
                self._standing = content
            case "error":
                self._frames = 0
                raise content

    def _receive(self) -> tuple[str, Any]:
        try:
            message: tuple[str, Any] = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise self._gone() from error
        return message

    def _send(self, *order: Any) -> None:
        try:
            self._pipe.send(order)
        except OSError as error:
            raise self._gone() from error

    def _gone(self) -> DatasetError:
        do = "See the error above; saved episodes are whole."
        return DatasetError(expected("storing process", "one that runs", "one that has ended", do))


def serve(pipe: Connection, slots: RowSlots, facts: RigFacts, settings: StoreSettings) -> None:
    """Store until told to close or the pipe ends: what the child does."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the loop says what to do
    os.nice(NICE)
    try:
        recorder = open_recorder(facts, settings)
    except UniForceError as error:
        pipe.send(("error", error))
        return
    with recorder:
        warm_up(recorder, facts)
        Child(pipe, slots, recorder).run()


def warm_up(recorder: EpisodeRecorder, facts: RigFacts) -> None:
    """Record a few black frames and forget them, so that the first real ones are as fast as the others."""
    pictures = {key for key, feature in recorder.features.items() if feature["dtype"] == "video"}
    row = {
        key: np.zeros(feature["shape"], "uint8" if key in pictures else feature["dtype"])
        for key, feature in recorder.features.items()
        if key not in RECORDERS_OWN
    }
    raw = {finger: np.zeros(shape, np.uint8) for finger, shape in facts.raw_frames.items()}
    for _ in range(WARM_UP_FRAMES):
        recorder.add(row, "warm-up", raw)
    recorder.discard()


class Child:
    """Does what it is ordered; after an error it ignores rows until the episode is discarded."""

    def __init__(self, pipe: Connection, slots: RowSlots, recorder: EpisodeRecorder) -> None:
        self._pipe, self._slots, self._recorder = pipe, slots, recorder
        self._references: dict[str, np.ndarray] = {}
        self._broken = False

    def run(self) -> None:
        """Serve until ``close`` or the pipe's end."""
        try:
            self._tell_standing()
            while self._obey(self._pipe.recv()):
                pass
        except (EOFError, OSError):
            log.warning("the recording loop has gone; the running episode is dropped")

    def _obey(self, order: tuple[Any, ...]) -> bool:
        """Do one order; return whether to go on."""
        kind, *details = order
        try:
            match kind:
                case "add":
                    self._add(*details)
                case "save":
                    self._recorder.save(*details)
                    self._tell_standing()
                case "discard":
                    self._recorder.discard()
                    self._broken = False
                    self._tell_standing()
        except UniForceError as error:
            self._broken = kind == "add"
            self._pipe.send(("error", error))
        return kind != "close"

    def _add(self, slot: int, task: str, known: set[str]) -> None:
        row, raw = self._slots.read(slot, known)
        self._references |= {key: row[key] for key in REFERENCES if key in row}
        try:
            if not self._broken:
                self._recorder.add({**row, **self._references}, task, raw)
        finally:
            self._pipe.send(("free", slot))

    def _tell_standing(self) -> None:
        standing = Standing(self._recorder.num_episodes, self._recorder.total_frames)
        self._pipe.send(("standing", standing))
