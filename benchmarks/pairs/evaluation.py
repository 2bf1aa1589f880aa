"""Does the score find the pairs that are out of equilibrium? Precision and recall against the simulator's truth.

Sessions are judged in order, as a recorder would: the first grasps with nothing learnt of the session yet.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uniforce_robots.pairs.pair_judge import PairJudge
from uniforce_robots.pairs.rehearsal import LIMIT, Rehearsal, SimulatedRig
from uniforce_robots.pairs.rig import RigFrame
from uniforce_robots.pairs.track import FingerReaders, GraspTrack, MotionLimits


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


def score_session(rehearsal: Rehearsal, indenters: tuple[str, ...], grasps: int) -> ScoredPairs:
    """Rehearse ``grasps`` grasps of each indenter with one pair of units and score every frame."""
    rig, judge = SimulatedRig(rehearsal), PairJudge()
    readers = FingerReaders(rig, rig.references())
    parts: list[tuple[np.ndarray, ...]] = []
    for indenter in indenters:
        frames = rig.frames(indenter)
        for _ in range(grasps):
            parts.append(_score_grasp(rig, judge, readers, frames, indenter))
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    return ScoredPairs("_".join(rig.sensors.values()), *columns)


def _score_grasp(
    rig: SimulatedRig, judge: PairJudge, readers: FingerReaders, frames: Iterator[RigFrame], indenter: str
) -> tuple[np.ndarray, ...]:
    T = rig.rehearsal.grasps.frames
    track = GraspTrack(rig.mass_kg, readers)
    for _ in range(T):
        track.add(next(frames))
    quality = judge.judge(track.signals())
    judge.learn(track.signals())
    number = track.frames[0].grasp
    truth = rig.truths[number]
    labels = (np.repeat(label, T) for label in (truth.fault, indenter, number))
    gate = track.gate(rig.rate_hz, MotionLimits())
    return quality.error, truth.error, quality.flagged, gate == "", *labels


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
