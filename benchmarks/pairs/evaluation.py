"""Does the score find the pairs out of equilibrium? Judged in order, as a recorder would."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from uniforce_robots.pairs.pair_judge import PairJudge
from uniforce_robots.pairs.rehearsal import LIMIT, Rehearsal, SimulatedRig
from uniforce_robots.pairs.rig import RigFrame
from uniforce_robots.pairs.track import FingerReaders, GraspTrack, MotionLimits

# a lean along the closing axis: not asked for, but real, and the hardest to find
BEYOND_THE_GOAL = "pushed"
# of the true error
BANDS = (
    (0.0, 0.05),
    (0.05, 0.08),
    (0.08, 0.10),
    (0.10, 0.12),
    (0.12, 0.20),
    (0.20, 0.50),
    (0.50, 9.0),
)
DRAWS = 1000  # of the bootstrap
QUANTILES = (0.025, 0.975)


@dataclass(frozen=True)
class ScoredPairs:
    """N pairs, in the order in which they were scored."""

    error: np.ndarray  # (N,) true error
    flagged: np.ndarray  # (N,) bool
    gate_open: np.ndarray  # (N,) bool, whether the hand was slow
    fault: np.ndarray  # (N,) what went wrong in their grasp
    grasp: np.ndarray  # (N,) number of the grasp, of all sessions
    rig: np.ndarray  # (N,) left and right sensor

    @classmethod
    def joined(cls, parts: Sequence["ScoredPairs"]) -> "ScoredPairs":
        """Return all pairs of several parts."""
        columns = {}
        for name in cls.__dataclass_fields__:
            columns[name] = np.concatenate([getattr(part, name) for part in parts])
        return cls(**columns)


def score_session(
    rehearsal: Rehearsal, indenters: tuple[str, ...], grasps: int, session: int = 0
) -> ScoredPairs:
    """Rehearse ``grasps`` grasps of each indenter with one pair of units and score every frame."""
    rig = SimulatedRig(rehearsal)
    judge = PairJudge()
    readers = FingerReaders(rig, rig.references())
    parts = []
    for indenter in indenters:
        frames = rig.frames(indenter)
        for _ in range(grasps):
            parts.append(_score_grasp(rig, judge, readers, frames, session))
    return ScoredPairs.joined(parts)


def _score_grasp(
    rig: SimulatedRig,
    judge: PairJudge,
    readers: FingerReaders,
    frames: Iterator[RigFrame],
    session: int,
) -> ScoredPairs:
    n = rig.rehearsal.grasps.frames
    track = GraspTrack(rig.mass_kg, readers)
    for _ in range(n):
        track.add(next(frames))
    quality = judge.judge(track.signals())
    judge.learn(track.signals())
    number = track.frames[0].grasp
    truth = rig.truths[number]
    return ScoredPairs(
        truth.error,
        quality.flagged,
        track.gate(rig.rate_hz, MotionLimits()) == "",
        np.repeat(truth.fault, n),
        np.repeat(number + 10_000 * session, n),
        np.repeat("_".join(rig.sensors.values()), n),
    )


def precision_recall(flagged: np.ndarray, bad: np.ndarray) -> dict[str, float]:
    """Return precision and recall of a flag with their counts; NaN: none flagged, or none bad."""
    hits = int((flagged & bad).sum())
    marked = int(flagged.sum())
    wrong = int(bad.sum())
    return {
        "pairs": len(bad),
        "bad": wrong,
        "flagged": marked,
        "right_flags": hits,
        "precision": hits / marked if marked else float("nan"),
        "recall": hits / wrong if wrong else float("nan"),
    }


def report(scored: ScoredPairs) -> dict[str, Any]:
    flagged = scored.flagged
    bad = scored.error > LIMIT
    goal = scored.fault != BEYOND_THE_GOAL
    by_true_error = {}
    for low, high in BANDS:
        band = flagged[(scored.error > low) & (scored.error <= high) & goal]
        share = float(band.mean()) if len(band) else float("nan")
        by_true_error[f"{low:g}-{high:g}"] = {"pairs": len(band), "flagged": share}
    # what a recorder would keep, gate and score together, all faults in play
    kept = scored.gate_open & ~flagged
    return {
        "what": "flag = estimated equilibrium error above the limit; "
        "bad = true error above 0.10; all simulated",
        "goal_faults": _with_interval(flagged[goal], bad[goal], scored.grasp[goal]),
        "all_faults": _with_interval(flagged, bad, scored.grasp),
        "kept_pairs": {
            "kept_share": float(kept.mean()),
            "bad_before": float(bad.mean()),
            "bad_among_kept": float(bad[kept].mean()),
            "good_kept": float(kept[~bad].mean()),
            "median_error_among_kept": float(np.median(scored.error[kept])),
        },
        "by_rig": _by(scored.rig[goal], flagged[goal], bad[goal]),
        "by_fault": _by(scored.fault, flagged, bad),
        "by_true_error": by_true_error,
    }


def _by(label: np.ndarray, flagged: np.ndarray, bad: np.ndarray) -> dict[str, dict[str, float]]:
    found = {}
    for name in np.unique(label):
        here = label == name
        found[str(name)] = precision_recall(flagged[here], bad[here])
    return found


def _with_interval(flagged: np.ndarray, bad: np.ndarray, grasp: np.ndarray) -> dict[str, Any]:
    """Return precision and recall with 95 % intervals of a bootstrap over whole grasps."""
    rng = np.random.default_rng(0)
    where = np.unique(grasp, return_inverse=True)[1]
    # (3, grasps)
    counts = np.stack([np.bincount(where, weights=w) for w in (flagged & bad, flagged, bad)])
    grasps = counts.shape[1]
    drawn = rng.multinomial(grasps, np.full(grasps, 1 / grasps), DRAWS)
    hits, marked, wrong = counts @ drawn.T
    return precision_recall(flagged, bad) | {
        "precision_95": np.quantile(hits / np.maximum(marked, 1), QUANTILES).tolist(),
        "recall_95": np.quantile(hits / np.maximum(wrong, 1), QUANTILES).tolist(),
        "grasps": grasps,
    }
