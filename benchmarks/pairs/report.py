"""Tables of the score's precision and recall, with intervals that respect that frames of one grasp are alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.pairs.evaluation import ScoredPairs, is_bad, precision_recall

BEYOND_THE_GOAL = "pushed"  # a lean along the closing axis: not asked for, but real, and the hardest to find
BANDS = ((0.0, 0.05), (0.05, 0.08), (0.08, 0.10), (0.10, 0.12), (0.12, 0.20), (0.20, 0.50), (0.50, 9.0))
THRESHOLDS = (0.06, 0.08, 0.10, 0.12, 0.14, 0.17, 0.20, 0.30)
DRAWS = 1000  # of the bootstrap


def report(scored: Sequence[ScoredPairs]) -> dict[str, Any]:
    """Return everything worth knowing of the score as JSON."""
    error, flagged, fault = (_joined(scored, name) for name in ("error", "flagged", "fault"))
    gate, indenter, estimated = (_joined(scored, name) for name in ("gate_open", "indenter", "estimated"))
    rig = np.concatenate([np.repeat(s.sensors, len(s.error)) for s in scored])
    grasp = np.concatenate([s.grasp + 10_000 * k for k, s in enumerate(scored)])
    bad = np.concatenate([is_bad(s) for s in scored])
    goal = fault != BEYOND_THE_GOAL
    return {
        "what": "flag = estimated equilibrium error above the limit; bad = true error above 0.10; all simulated",
        "goal_faults": _with_interval(flagged[goal], bad[goal], grasp[goal]),
        "all_faults": _with_interval(flagged, bad, grasp),
        "kept_pairs": _kept(flagged, gate, bad, error),
        "by_rig": _by(rig, flagged & goal, bad & goal, goal),
        "by_rig_all_faults": _by(rig, flagged, bad),
        "by_indenter": _by(indenter, flagged & goal, bad & goal, goal),
        "by_fault": _by(fault, flagged, bad),
        "by_true_error": {
            f"{low:g}-{high:g}": _share(flagged, (error > low) & (error <= high) & goal)
            for low, high in BANDS
        },
        "by_threshold": {
            f"{limit:g}": precision_recall((estimated > limit)[goal], bad[goal]) for limit in THRESHOLDS
        },
    }


def _joined(scored: Sequence[ScoredPairs], name: str) -> np.ndarray:
    return np.concatenate([getattr(s, name) for s in scored])


def _by(
    label: np.ndarray, flagged: np.ndarray, bad: np.ndarray, rows: np.ndarray | None = None
) -> dict[str, dict[str, float]]:
    rows = np.ones(len(bad), bool) if rows is None else rows
    found = {}
    for name in np.unique(label):
        here = (label == name) & rows
        found[str(name)] = precision_recall(flagged[here], bad[here])
    return found


def _share(flagged: np.ndarray, rows: np.ndarray) -> dict[str, float]:
    count = int(rows.sum())
    return {"pairs": count, "flagged": float(flagged[rows].mean()) if count else float("nan")}


def _kept(flagged: np.ndarray, gate: np.ndarray, bad: np.ndarray, error: np.ndarray) -> dict[str, float]:
    """What a recorder would keep, gate and score together, all faults in play."""
    kept = gate & ~flagged
    return {
        "kept_share": float(kept.mean()),
        "bad_before": float(bad.mean()),
        "bad_among_kept": float(bad[kept].mean()),
        "good_kept": float(kept[~bad].mean()),
        "median_error_among_kept": float(np.median(error[kept])),
    }


def _with_interval(flagged: np.ndarray, bad: np.ndarray, grasp: np.ndarray) -> dict[str, Any]:
    """Precision and recall with 95 % intervals of a bootstrap over whole grasps."""
    rng = np.random.default_rng(0)
    _, where = np.unique(grasp, return_inverse=True)
    counts = np.stack([np.bincount(where, weights=w) for w in (flagged & bad, flagged, bad)])  # (3, grasps)
    drawn = rng.multinomial(counts.shape[1], np.full(counts.shape[1], 1 / counts.shape[1]), DRAWS)
    hits, marked, wrong = counts @ drawn.T
    intervals = {
        "precision_95": np.quantile(hits / np.maximum(marked, 1), (0.025, 0.975)).tolist(),
        "recall_95": np.quantile(hits / np.maximum(wrong, 1), (0.025, 0.975)).tolist(),
    }
    return precision_recall(flagged, bad) | intervals | {"grasps": counts.shape[1]}
