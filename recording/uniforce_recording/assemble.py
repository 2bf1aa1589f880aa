"""Connect the parts, run a session, and take everything apart again in order, whatever happens."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

import numpy as np
from lerobot.teleoperators import Teleoperator

from uniforce_datasets.source import read_source
from uniforce_recording.disk_guard import DiskGuard
from uniforce_recording.episode_loop import Parts
from uniforce_recording.expert_demos import next_seed
from uniforce_recording.interrupts import Interrupts
from uniforce_recording.live_view import ForceLimits, LiveView
from uniforce_recording.operators import KeyOperator, Nobody, Operator
from uniforce_recording.rig import Rig, RigFacts
from uniforce_recording.session import RecordingSession, SessionEnd, SessionSettings
from uniforce_recording.steering import Steering
from uniforce_recording.store import Store, StoreSettings, open_recorder
from uniforce_recording.store_process import StoreProcess
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.keys import OUTCOME, OUTCOME_NAMES

# Python's own 5 ms between two threads' turns would be the largest part of a tick's lateness.
SWITCH_s = 0.0005


def open_store(facts: RigFacts, settings: StoreSettings) -> Store:
    """Return the recorder, in a process of its own or in this one.

    Raises:
        DatasetError: another recorder writes there, or the dataset has other features.
    """
    return StoreProcess(facts, settings) if settings.own_process else open_recorder(facts, settings)


def make_operator(kind: str, verdict: str, quick_notes: Sequence[str], teleop: Teleoperator) -> Operator:
    """Return who judges.

    Args:
        kind: ``keys`` or ``nobody``.
        verdict: what nobody calls every episode.
        quick_notes: what digits mean.
        teleop: where it reads the terminal itself, its other keys are used.

    Raises:
        ContractError: another kind.
    """
    match kind:
        case "keys":
            keys = getattr(teleop, "keys", None)
            return KeyOperator(keys if hasattr(keys, "take_others") else None, quick_notes)
        case "nobody":
            return Nobody(verdict)
        case _:
            raise ContractError(expected("operator", "keys | nobody", repr(kind), "Name one."))


def judged_episodes(root: Path, have: int) -> int:
    """Return how many saved episodes count: all but the aborted ones."""
    if not have:
        return 0
    source = read_source(root)
    outcomes = source.columns((OUTCOME,))[OUTCOME]
    ends = np.array([episode.start for episode in source.episodes])
    return int((outcomes[ends] != OUTCOME_NAMES.index("aborted")).sum())


def run_session(
    rig: Rig,
    teleop: Teleoperator,
    operator: Operator,
    store: StoreSettings,
    settings: SessionSettings,
    seed: int = 0,
    out: TextIO | None = None,
    limits: ForceLimits | None = None,
) -> SessionEnd:
    """Connect, record, disconnect.

    Args:
        rig: not connected.
        teleop: not connected.
        operator: not started.
        store: where to.
        settings: what.
        seed: of the first episode of an empty dataset.
        out: where progress goes; None shows nothing.
        limits: of the live view's force.

    Raises:
        UniForceError: nothing could be connected.
        KeyboardInterrupt: interrupted twice; everything has been let go.
    """
    steering = Steering(teleop)
    with Interrupts() as interrupts, ExitStack() as closing:
        closing.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_s)
        recorder = open_store(rig.facts, store)
        closing.callback(recorder.close)
        closing.callback(operator.stop)
        closing.callback(steering.close)
        closing.callback(rig.close)
        closing.callback(
            rig.hold
        )  # last in, first done: whatever ends this, the robot rests before anything is closed
        rig.connect()
        steering.connect()
        operator.start()
        raw_pixels = sum(shape[0] * shape[1] for shape in rig.facts.raw_frames.values())
        disk = DiskGuard(store.root, recorder.features, raw_pixels, store.reserve_MB)
        view = LiveView(out, limits, rig.facts.fps)
        parts = Parts(rig, steering, operator, recorder, disk, view, interrupts)
        have = recorder.num_episodes
        session = RecordingSession(
            parts, settings, judged_episodes(store.root, have), next_seed(store.root, have, seed)
        )
        return session.run()
