"""Does the score find the pairs that are out of equilibrium? Precision and recall against the simulator's truth.

Sessions are judged in order, as a recorder would: the first grasps with nothing learnt of the session yet.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uniforce_pair_recording.finger_force import FingerForce
from uniforce_pair_recording.gate import quasi_static
from uniforce_pair_recording.pair_judge import JudgeSettings, PairJudge
from uniforce_pair_recording.rehearsal import Rehearsal, SimulatedRig
from uniforce_pair_recording.rig import RigFrame
from uniforce_pair_recording.track import FingerReader, GraspTrack
from uniforce_pair_recording.truth import LIMIT
from uniforce_vtla.contracts import FINGERS


@dataclass(frozen=True)
class ScoredPairs:
    """N pairs of one session.

    Attributes:
        sensors: left and right.
        estimated: (N,) error as scored.
        error: (N,) true error.
        flagged: (N,) bool.
        gate_open: (N,) bool, whether the hand was slow.
        fault: (N,) what went wrong in their grasp.
        indenter: (N,) names.
        grasp: (N,) number of the grasp within the session.
    """

    sensors: str
    estimated: np.ndarray
    error: np.ndarray
    flagged: np.ndarray
    gate_open: np.ndarray
    fault: np.ndarray
    indenter: np.ndarray
    grasp: np.ndarray


def score_session(
    rehearsal: Rehearsal, indenters: tuple[str, ...], grasps: int, settings: JudgeSettings | None = None
) -> ScoredPairs:
    """Rehearse ``grasps`` grasps of each indenter with one pair of units and score every frame."""
    rig, judge = SimulatedRig(rehearsal), PairJudge(settings)
    references = rig.references()
    readers = {
        f: FingerReader(references[f], f, FingerForce.from_pretrained(rig.sensors[f])) for f in FINGERS
    }
    parts: list[tuple[np.ndarray, ...]] = []
    for indenter in indenters:
        frames = rig.frames(indenter)
        for _ in range(grasps):
            parts.append(_score_grasp(rig, judge, readers, frames, indenter))
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    return ScoredPairs("_".join(rig.sensors.values()), *columns)


def _score_grasp(
    rig: SimulatedRig,
    judge: PairJudge,
    readers: dict,
    frames: Iterator[RigFrame],
    indenter: str,
) -> tuple[np.ndarray, ...]:
    T = rig.rehearsal.grasps.frames
    track = GraspTrack(rig.mass_kg)
    for _ in range(T):
        track.add(next(frames), readers)
    signals = track.signals()
    quality = judge.judge(signals)
    judge.learn(signals)
    contact = np.maximum(signals.left_N[:, 2], signals.right_N[:, 2])
    gate = quasi_static(signals.velocity_m_s, signals.acceleration_m_s2, contact, rig.rate_hz)
    number = track.frames[0].grasp
    truth = rig.truth_of(number)
    labels = (np.repeat(label, T) for label in (truth.fault, indenter, number))
    return quality.error, truth.error, quality.flagged, gate.is_open, *labels


def precision_recall(flagged: np.ndarray, bad: np.ndarray) -> dict[str, float]:
    """Return precision and recall of a flag with their counts; NaN where nothing was flagged, or nothing is bad."""
    hits = int((flagged & bad).sum())
    marked, wrong = int(flagged.sum()), int(bad.sum())
    return {
        "pairs": len(bad),
        "bad": wrong,
        "flagged": marked,
        "right_flags": hits,
        "precision": hits / marked if marked else float("nan"),
        "recall": hits / wrong if wrong else float("nan"),
    }


def is_bad(scored: ScoredPairs) -> np.ndarray:
    """(N,) bool: true error above the limit."""
    return scored.error > LIMIT
