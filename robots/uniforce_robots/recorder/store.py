"""The recorder in a process of its own: no tick of the loop waits for encoding and storing.

Python threads share one lock; with eight videos encoded in the loop's own process a tick takes 90
ms instead of 15. Rows go through shared memory, orders and answers through a pipe, one answer to
each order. Where the loop's process dies the pipe ends: orders are finished, the running episode is
dropped, and the dataset is free for the next session. Hence no ``ProcessPoolExecutor``, whose
workers outlive a killed parent.
"""

import logging
import multiprocessing
import os
import signal
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.staging import claim
from uniforce_robots.recorder.faults import handled
from uniforce_robots.recorder.rig import RigFacts
from uniforce_robots.recorder.rows import RECORDERS_OWN, RowSlots, further_columns, rig_features
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import (
    DatasetError,
    DiskFullError,
    DroppedFrameError,
    UniForceError,
    expected,
)
from uniforce_vtla.options import absolute

log = logging.getLogger(__name__)
# a session that was killed leaves a storing process that finishes its orders first
LOCK_WAIT_s = 20.0
QUEUE_FRAMES = 60  # that may wait per video: 2 s of a busy computer
SLOTS = 30  # rows on the way: a second of a busy child, some 4 MB each
START_s = 120.0  # imports of LeRobot and torch on a starved machine
ANSWER_s = 180.0  # the longest save: LeRobot itself waits 120 s for an encoder
SLOT_s = 60.0  # how long a scene that isn't paced waits for a slot
NICE = 2  # the loop comes first, but a little only: frames must not pile up either
WARM_UP_FRAMES = 3  # the first ones import, open and allocate for half a second


@dataclass(frozen=True)
class StoreSettings:
    """The dataset's folder, LeRobot's name for it, and how many MB must stay free on the disk."""

    root: Path
    repo_id: str
    reserve_MB: float = 500.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", absolute(self.root))


def open_recorder(facts: RigFacts, settings: StoreSettings) -> EpisodeRecorder:
    """Return the recorder of a rig's columns, in this process.

    Raises DatasetError: another recorder writes there, or the dataset has other features.
    """
    return EpisodeRecorder(
        settings.root,
        settings.repo_id,
        facts.sensors["left"],
        facts.sensors["right"],
        facts.fps,
        cameras=facts.cameras,
        truth=facts.simulated,
        realtime=facts.paced,
        queue_frames=QUEUE_FRAMES,
        further=further_columns(facts),
        raw_shapes=facts.raw_frames,
        lock_wait_s=LOCK_WAIT_s,
    )


class StoreGoneError(DatasetError):
    """The storing process has ended, or doesn't answer; what was saved is whole."""


class StoreProcess:
    """``EpisodeRecorder`` in another process. An error of ``add`` shows at a later call.

    That is ``save`` at the latest. The child starts in the background; the first question waits
    until it is ready, and raises its error. A folder that can't be written to is a DatasetError at
    once. ``num_frames`` are those of the running episode.
    """

    def __init__(self, facts: RigFacts, settings: StoreSettings) -> None:
        context = multiprocessing.get_context("spawn")  # never fork: threads of cameras and clients
        # a folder that can't be one is refused at once, not after the child's imports
        claim(settings.root)
        self.features = rig_features(facts)
        self.num_frames = 0
        self._slot_s = 0.0 if facts.paced else SLOT_s
        self._slots = RowSlots(facts, SLOTS, context)
        self._unanswered = 1  # the first answer comes by itself, when the child is ready
        self._rows = 0  # sent so far; answers come in order, so slots are free in order
        # episodes, frames; None until the child is ready
        self._stored: tuple[int, int] | None = None
        self._pipe, other = context.Pipe()
        given = (other, self._slots, facts, settings)
        self._process = context.Process(target=serve, args=given, name="store", daemon=True)
        # Signals go to the whole group; the child ignores them: the loop gives the orders.
        with handled(signal.SIG_IGN):
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
        self, row: Mapping[str, Any], task: str, raw: Mapping[Finger, np.ndarray] | None = None
    ) -> None:
        """Hand a row over; see ``EpisodeRecorder.add``.

        Raises DroppedFrameError: the child is a second behind; DatasetError, ContractError: an
        earlier row could not be stored.
        """
        self._known()
        while self._has_answer() or self._unanswered >= SLOTS:
            if not self._has_answer(self._slot_s):
                do = "The episode ends here: free the computer, or record smaller pictures."
                raise DroppedFrameError(expected("storing", f"≤ {SLOTS} frames behind", "more", do))
            self._take_answer()
        slot = self._rows % SLOTS
        self._slots.write(slot, row, raw or {})
        self._rows += 1
        self._order("add", slot, task)
        self.num_frames += 1

    def save(self, *outcome: Any, **more: Any) -> None:
        """Make the episode durable, and wait; arguments as for ``EpisodeRecorder.save``."""
        self._finish("save", outcome, more)

    def discard(self) -> None:
        """Forget the running episode, and the error that broke it."""
        try:
            self._finish("discard")
        except StoreGoneError:
            raise
        except UniForceError as error:
            log.info("discarded after %s", error)

    def close(self) -> None:
        """Let the child finish and end; one that isn't ready yet has nothing to finish.

        Raises DiskFullError: no room for the last of it; the child has ended, saved data is whole.
        """
        try:
            if self._stored is None:
                self._process.kill()
            elif self._process.exitcode is None:
                self._finish("close")
        except DiskFullError:
            raise
        except UniForceError as error:
            log.error("%s", error)
        finally:
            self._end()

    def _end(self) -> None:
        self._process.join(ANSWER_s)
        if self._process.exitcode is None:
            log.error("the storing process doesn't end; it is killed, saved episodes are whole")
            self._process.kill()
            self._process.join()
        self._pipe.close()

    # --- the pipe -----------------------------------------------------------------------------

    def _known(self) -> tuple[int, int]:
        """Return how many episodes and frames are stored; raises the child's error at its start."""
        while self._stored is None:
            self._take_answer(START_s)
        return self._stored

    def _finish(self, *order: Any) -> None:
        """Give an order and wait for every answer; raise the first error among them."""
        self.num_frames = 0
        self._order(*order)
        first: UniForceError | None = None
        while self._unanswered:
            try:
                self._take_answer(ANSWER_s)
            except StoreGoneError as error:
                raise first or error from error
            except UniForceError as error:
                first = first or error
        if first is not None:
            raise first

    def _order(self, *order: Any) -> None:
        try:
            self._pipe.send(order)
        except OSError as error:
            raise _gone() from error
        self._unanswered += 1

    def _take_answer(self, timeout_s: float = 0.0) -> None:
        if not self._has_answer(timeout_s):
            do = "The disk hangs? Saved episodes are whole."
            raise StoreGoneError(
                expected("storing", f"an answer within {timeout_s:g} s", "none", do)
            )
        try:
            error, stored = self._pipe.recv()
        except (EOFError, OSError) as ended:
            raise _gone() from ended
        self._unanswered -= 1
        if error is not None:
            self.num_frames = 0
            raise error
        self._stored = stored

    def _has_answer(self, timeout_s: float = 0.0) -> bool:
        try:
            return self._pipe.poll(timeout_s)
        except OSError as error:
            raise _gone() from error


def _gone() -> StoreGoneError:
    do = "See the error above; saved episodes are whole."
    return StoreGoneError(expected("storing process", "one that runs", "one that ended", do))


# --- the child --------------------------------------------------------------------------------


def serve(pipe: Connection, slots: RowSlots, facts: RigFacts, settings: StoreSettings) -> None:
    """Store until ``close`` or the pipe's end: what the child does."""
    os.nice(NICE)
    try:
        recorder = open_recorder(facts, settings)
        _warm_up(recorder, facts)
    except UniForceError as error:
        pipe.send((error, None))
        return
    try:
        _obey_all(pipe, slots, recorder)
    except (EOFError, OSError):
        log.warning("the recording loop has gone; the running episode is dropped")
        recorder.close()


def _warm_up(recorder: EpisodeRecorder, facts: RigFacts) -> None:
    """Record and forget a few black frames, so that the first real ones are as fast as others."""
    row = {}
    for key, feature in recorder.features.items():
        if key not in RECORDERS_OWN:
            dtype = feature["dtype"]
            row[key] = np.zeros(feature["shape"], "uint8" if dtype == "video" else dtype)
    raw = {finger: np.zeros(shape, np.uint8) for finger, shape in facts.raw_frames.items()}
    for _ in range(WARM_UP_FRAMES):
        recorder.add(row, "warm-up", raw)
    recorder.discard()


def _obey_all(pipe: Connection, slots: RowSlots, recorder: EpisodeRecorder) -> None:
    """Do and answer each order; after an error ignore the rest of an episode, its save too."""
    order: tuple[Any, ...] = ("ready",)
    broken = False
    while True:
        error = None
        try:
            match order:
                case ("save" | "discard", *_) if broken:
                    recorder.discard()
                case ("add", slot, task) if not broken:
                    row, raw = slots.read(slot)
                    recorder.add(row, task, raw)
                case ("save", outcome, more):
                    recorder.save(*outcome, **more)
                case ("discard",):
                    recorder.discard()
                case ("close",):
                    recorder.close()
        except UniForceError as came:
            error = came
        broken = (broken or error is not None) and order[0] == "add"
        pipe.send((error, (recorder.num_episodes, recorder.total_frames)))
        if order[0] == "close":
            return
        order = pipe.recv()
