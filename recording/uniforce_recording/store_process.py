"""The recorder in a process of its own: whatever it takes to encode and store, no tick of the loop waits for it.

Python threads share one lock; with eight videos encoded in the loop's own process a tick takes 90 ms instead of 15.
Rows go through shared memory, orders and answers through a pipe. Where the loop's process dies, the pipe ends: what
was ordered is finished, the running episode is dropped, and the dataset is free for the next session.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from uniforce_datasets.features import dataset_features
from uniforce_recording.rig import RigFacts
from uniforce_recording.row_slots import REFERENCES, RowSlots
from uniforce_recording.rows import further_columns
from uniforce_recording.store import StoreSettings
from uniforce_recording.store_child import Standing, serve
from uniforce_vtla.contracts import Finger
from uniforce_vtla.errors import DatasetError, DroppedFrameError, expected

log = logging.getLogger(__name__)
SLOTS = 30  # rows on the way: a second of a busy child, some 4 MB each
START_s = 120.0  # imports of LeRobot and torch on a starved machine
ANSWER_s = 180.0  # the longest save: LeRobot itself waits 120 s for an encoder
PATIENCE_s = 60.0  # how long a scene that isn't paced waits for a slot


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
        with _deaf_to_ctrl_c():
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


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Let a child inherit that Ctrl-C is ignored: it goes to the whole group, also while the child still imports."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
