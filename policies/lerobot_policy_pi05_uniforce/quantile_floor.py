"""A floor under quantile spans, so that an axis that never moved in the demos can't explode at rollout."""

from __future__ import annotations

from typing import Any

import numpy as np

from uniforce_vtla.keys import ACTION, STATE

SPAN_FLOOR = (0.005, 0.005, 0.005, 0.02, 0.002)  # m, m, m, rad, m: below this a spread is noise


def floor_quantiles(stats: dict[str, dict[str, Any]] | None) -> dict[str, dict[str, Any]] | None:
    """Return ``stats`` with q01…q99 of state and action at least ``SPAN_FLOOR`` apart, centre kept.

    Other keys pass untouched, and so do vectors that don't have the five axes of the contract.  Applying it
    twice changes nothing.
    """
    if not stats:
        return stats
    return {key: _floor(value) if key in (STATE, ACTION) else value for key, value in stats.items()}


def _floor(stat: dict[str, Any]) -> dict[str, Any]:
    if "q01" not in stat or np.size(stat["q01"]) != len(SPAN_FLOOR):
        return stat
    low, high = (np.asarray(stat[q], dtype=np.float64) for q in ("q01", "q99"))
    lack = np.maximum(np.asarray(SPAN_FLOOR) - (high - low), 0.0) / 2
    return {**stat, "q01": low - lack, "q99": high + lack}
