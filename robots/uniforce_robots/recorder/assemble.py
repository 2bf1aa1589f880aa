"""Connect the parts, run a session, and take everything apart again in order, whatever happens."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TextIO, cast

import numpy as np
from lerobot.teleoperators import Teleoperator

from uniforce_datasets.rig_settings import agreed_changes
from uniforce_datasets.source import read_source
from uniforce_robots.recorder.disk_guard import DiskGuard
from uniforce_robots.recorder.episode import Parts, Store
from uniforce_robots.recorder.faults import Interrupts
from uniforce_robots.recorder.operators import LiveView, Operator
from uniforce_robots.recorder.rig import Rig, RigFacts
from uniforce_robots.recorder.session import RecordingSession, SessionEnd, SessionSettings
from uniforce_robots.recorder.steering import Steering
from uniforce_robots.recorder.store import StoreProcess, StoreSettings
from uniforce_vtla.keys import OUTCOME, OUTCOME_NAMES, SEED
from uniforce_vtla.terminal import LastingText

# Python's own 5 ms between two threads' turns would be the largest part of a tick's lateness.
SWITCH_s = 0.0005


def judged_episodes(root: Path, have: int) -> int:
    """Return how many saved episodes count: all but the aborted ones."""
    if not have:
        return 0
    source = read_source(root)
    outcomes = source.columns((OUTCOME,))[OUTCOME]
    starts = np.array([episode.start for episode in source.episodes])
    return int((outcomes[starts] != OUTCOME_NAMES.index("aborted")).sum())


def next_seed(root: Path, have: int, first: int) -> int:
    """Return the seed to go on with: seeds go on where the last session stopped."""
    if not have:
        return first
    return int(read_source(root).columns((SEED,))[SEED].max()) + 1


def run_session(
    rig: Rig,
    teleop: Teleoperator,
    operator: Operator,
    store: StoreSettings,
    settings: SessionSettings,
    seed: int = 0,
    out: TextIO | None = None,
    open_store: Callable[[RigFacts, StoreSettings], Store] = StoreProcess,
) -> SessionEnd:
    """Connect, record, disconnect; nothing is connected before.

    ``seed`` is that of the first episode of an empty dataset; without ``out`` no progress is shown.

    Raises UniForceError: nothing could be connected, or the dataset was recorded with other
    settings; KeyboardInterrupt: interrupted twice; everything has been let go.
    """
    steering = Steering(teleop)
    interrupts = Interrupts()
    with interrupts.counted(), ExitStack() as closing:
        closing.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_s)
        recorder = open_store(rig.facts, store)
        for close in (recorder.close, operator.stop, steering.close, rig.close, rig.hold):
            # last in, first done: the robot rests before anything is closed
            closing.callback(close)
        rig.connect()
        steering.connect()
        operator.start()
        raw_pixels = sum(shape[0] * shape[1] for shape in rig.facts.raw_frames.values())
        disk = DiskGuard(store.root, recorder.features, raw_pixels, store.reserve_MB)
        view = LiveView(out and cast("TextIO", LastingText(out)), rig.facts.fps)
        parts = Parts(rig, steering, operator, recorder, disk, view, interrupts)
        have = recorder.num_episodes  # from here on the dataset lies still
        rig_settings = settings.rig | rig.stored_facts()
        changes = agreed_changes(store.root, rig_settings, settings.accept_changes)
        of_cards = {**settings.settings, "rig": rig_settings, "changed": changes}
        settings = replace(settings, settings=of_cards, rig=rig_settings)
        judged = judged_episodes(store.root, have)
        first = next_seed(store.root, have, seed)
        return RecordingSession(parts, settings, judged, first).run()
