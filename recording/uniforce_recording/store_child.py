"""What the storing process does: take rows out of shared memory, record them, answer."""

from __future__ import annotations

import logging
import os
import signal
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_recording.rig import RigFacts
from uniforce_recording.row_slots import RECORDERS_OWN, REFERENCES, RowSlots
from uniforce_recording.store import StoreSettings, open_recorder
from uniforce_vtla.errors import UniForceError

log = logging.getLogger(__name__)
NICE = 2  # the loop comes first, but a little only: frames must not pile up either
WARM_UP_FRAMES = 3  # the first ones import, open and allocate for half a second


@dataclass(frozen=True)
class Standing:
    """What the child answers: how much is in the dataset."""

    episodes: int
    frames: int


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
