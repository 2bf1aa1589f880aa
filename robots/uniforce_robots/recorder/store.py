"""The recorder in a process of its own: whatever it takes to encode and store, no tick of the loop waits for it.

Python threads share one lock; with eight videos encoded in the loop's own process a tick takes 90 ms instead of 15.
Rows go through shared memory, orders and answers through a pipe, one answer to each order. Where the loop's process
dies the pipe ends: what was ordered is finished, the running episode is dropped, and the dataset is free for the next
session. That is why this is no ``ProcessPoolExecutor``, whose workers outlive a killed parent.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_datasets.features import dataset_features
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_robots.recorder.rig import RigFacts
from uniforce_robots.recorder.rows import RECORDERS_OWN, RowSlots, further_columns
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import DatasetError, DroppedFrameError, UniForceError, expected

log = logging.getLogger(__name__)
LOCK_WAIT_s = 20.0  # a session that was killed leaves a storing process that finishes its orders first
QUEUE_FRAMES = 60  # that may wait per video: 2 s of a busy computer
SLOTS = 30  # rows on the way: a second of a busy child, some 4 MB each
START_s = 120.0  # imports of LeRobot and torch on a starved machine
ANSWER_s = 180.0  # the longest save: LeRobot itself waits 120 s for an encoder
SLOT_s = 60.0  # how long a scene that isn't paced waits for a slot
NICE = 2  # the loop comes first, but a little only: frames must not pile up either
WARM_UP_FRAMES = 3  # the first ones import, open and allocate for half a second


@dataclass(frozen=True)
class StoreSettings:
    """Where to: the dataset's folder, LeRobot's name for it, and how many MB must stay free on the disk."""

    root: Path
    repo_id: str
    reserve_MB: float = 500.0


def open_recorder(facts: RigFacts, settings: StoreSettings) -> EpisodeRecorder:
    """Return the recorder of a rig's columns, in this process.

    Raises:
        DatasetError: another recorder writes there, or the dataset has other features.
    """
    return EpisodeRecorder(
        settings.root,
        settings.repo_id,
        facts.sensors["left"],
        facts.sensors["right"],
        facts.fps,
        cameras=facts.cameras,
        truth=facts.truth,
        realtime=facts.paced,
        queue_frames=QUEUE_FRAMES,
        further=further_columns(facts),
        raw_shapes=facts.raw_frames,
        lock_wait_s=LOCK_WAIT_s,
    )


class StoreProcess:
    """``EpisodeRecorder`` elsewhere. An error of ``add`` shows at a later call, at the latest at ``save``.

    The child starts in the background; the first question waits until it is ready, and raises what kept it from it.

    Attributes:
        features: LeRobot's features dict of what is recorded.
        num_frames: frames of the running episode.
        pid: of the child.
    """

    def __init__(self, facts: RigFacts, settings: StoreSettings) -> None:
        context = multiprocessing.get_context("spawn")  # never fork: threads of cameras and clients
        self.features = dataset_features(facts.cameras, facts.truth, further_columns(facts))
        self.num_frames = 0
        self._paced = facts.paced
        self._slots = RowSlots(facts, SLOTS, context)
        self._unanswered = 1  # the first answer comes by itself, when the child is ready
        self._rows = 0  # sent so far; answers come in order, so slots are free in order
        self._stored: tuple[int, int] | None = None  # episodes, frames; None until the child is ready
        self._pipe, other = context.Pipe()
        self._process = context.Process(
            target=serve, args=(other, self._slots, facts, settings), name="store", daemon=True
        )
        with _ctrl_c_ignored():
            self._process.start()
        self.pid = self._process.pid or 0
        other.close()

    @property
    def num_episodes(self) -> int:
        """Saved episodes."""
        return self._known()[0]

    @property
    def total_frames(self) -> int:
        """Frames of all saved episodes."""
        return self._known()[1]

    def add(
        self, frame: Mapping[str, Any], task: str, raw: Mapping[Finger, np.ndarray] | None = None
    ) -> None:
        """Hand a row over; see ``EpisodeRecorder.add``.

        Raises:
            DroppedFrameError: the child is a second behind.
            DatasetError, ContractError: an earlier row could not be stored.
        """
        self._known()
        deadline_s = time.monotonic() + (0.0 if self._paced else SLOT_s)
        while self._has_answer():
            self._take_answer()
        while self._unanswered >= SLOTS:
            if not self._has_answer(deadline_s - time.monotonic()):
                do = "The episode ends here: free the computer, or record smaller pictures."
                raise DroppedFrameError(expected("storing", f"≤ {SLOTS} frames behind", "more", do))
            self._take_answer()
        slot = self._rows % SLOTS
        self._slots.write(slot, frame, raw or {})
        self._rows += 1
        self._order("add", slot, task)
        self.num_frames += 1

    def save(self, *outcome: Any, **more: Any) -> None:
        """Make the episode durable; arguments as for ``EpisodeRecorder.save``. Waits until it is."""
        self.num_frames = 0
        self._order("save", outcome, more)
        self._take_all()

    def discard(self) -> None:
        """Forget the running episode, and the error that broke it."""
        self.num_frames = 0
        self._order("discard")
        try:
            self._take_all()
        except UniForceError as error:
            if self._unanswered:  # the child itself is gone or hangs
                raise
            log.info("discarded after %s", error)

    def close(self) -> None:
        """Let the child finish and end; one that isn't ready yet has nothing to finish."""
        if self._stored is None:
            self._process.kill()
        elif self._process.exitcode is None:
            try:
                self._order("close")
            except DatasetError as error:
                log.error("%s", error)
        self._process.join(ANSWER_s)
        if self._process.exitcode is None:
            log.error("the storing process doesn't end; it is killed, saved episodes are whole")
            self._process.kill()
            self._process.join()
        self._pipe.close()

    # --- the pipe ----------------------------------------------------------------------------------------------------

    def _known(self) -> tuple[int, int]:
        """Return how many episodes and frames are stored; raises what kept the child from starting."""
        while self._stored is None:
            self._take_answer(START_s)
        return self._stored

    def _order(self, *order: Any) -> None:
        with _connected():
            self._pipe.send(order)
        self._unanswered += 1

    def _take_all(self) -> None:
        """Wait for every answer; raise the first error among them."""
        first: UniForceError | None = None
        while self._unanswered:
            before = self._unanswered
            try:
                self._take_answer(ANSWER_s)
            except UniForceError as error:
                first = first or error
                if self._unanswered == before:
                    break
        if first is not None:
            raise first

    def _take_answer(self, timeout_s: float = 0.0) -> None:
        if not self._has_answer(timeout_s):
            do = "The disk hangs? Saved episodes are whole."
            raise DatasetError(expected("storing", f"an answer within {timeout_s:g} s", "none", do))
        with _connected():
            error, stored = self._pipe.recv()
        self._unanswered -= 1
        if error is not None:
            self.num_frames = 0
            raise error
        self._stored = stored

    def _has_answer(self, timeout_s: float = 0.0) -> bool:
        with _connected():
            return self._pipe.poll(max(timeout_s, 0.0))


@contextmanager
def _connected() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError) as error:
        do = "See the error above; saved episodes are whole."
        raise DatasetError(expected("storing process", "one that runs", "one that ended", do)) from error


@contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Let a child inherit that Ctrl-C is ignored: it goes to the whole group, also while the child still imports."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# --- the child -------------------------------------------------------------------------------------------------------


def serve(pipe: Connection, slots: RowSlots, facts: RigFacts, settings: StoreSettings) -> None:
    """Store until ``close`` or the pipe's end: what the child does."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the loop gives the orders
    os.nice(NICE)
    try:
        recorder = open_recorder(facts, settings)
    except UniForceError as error:
        pipe.send((error, None))
        return
    with recorder:
        warm_up(recorder, facts)
        try:
            _obey_all(pipe, slots, recorder)
        except (EOFError, OSError):
            log.warning("the recording loop has gone; the running episode is dropped")


def warm_up(recorder: EpisodeRecorder, facts: RigFacts) -> None:
    """Record a few black frames and forget them, so that the first real ones are as fast as the others."""
    row = {
        key: np.zeros(feature["shape"], "uint8" if feature["dtype"] == "video" else feature["dtype"])
        for key, feature in recorder.features.items()
        if key not in RECORDERS_OWN
    }
    raw = {finger: np.zeros(shape, np.uint8) for finger, shape in facts.raw_frames.items()}
    for _ in range(WARM_UP_FRAMES):
        recorder.add(row, "warm-up", raw)
    recorder.discard()


def _obey_all(pipe: Connection, slots: RowSlots, recorder: EpisodeRecorder) -> None:
    """Do each order and answer it; after an error the rest of an episode is ignored, its save too."""
    kind, details, broken = "ready", list[Any](), False
    while kind != "close":
        error = None
        try:
            if broken and kind in ("save", "discard"):
                recorder.discard()
            elif not broken:
                _obey(slots, recorder, kind, details)
        except UniForceError as came:
            error = came
        broken = (broken or error is not None) and kind == "add"
        pipe.send((error, (recorder.num_episodes, recorder.total_frames)))
        kind, *details = pipe.recv()


def _obey(slots: RowSlots, recorder: EpisodeRecorder, kind: str, details: list[Any]) -> None:
    match kind:
        case "add":
            slot, task = details
            row, raw = slots.read(slot)
            recorder.add(row, task, raw)
        case "save":
            outcome, more = details
            recorder.save(*outcome, **more)
        case "discard":
            recorder.discard()
