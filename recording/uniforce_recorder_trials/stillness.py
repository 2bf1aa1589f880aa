"""When the arm came to rest, by its own log of a thousand states a second; the recorder isn't asked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

REST_m = (
    1e-3  # the arm goes round at 63 mm/s: within this of where it ends means 16 ms before its target stopped
)
STILL_m = 5e-4  # how far it may still creep
WATCHED_s = 0.3  # at the end


def hold_s(wire: Sequence[dict], fault_s: float) -> float | None:
    """Return the seconds from a fault until the arm was where it stayed; None where it went on moving.

    Args:
        wire: the arm's log from before the fault until well after the rest.
        fault_s: when it was broken, ``time.monotonic``.
    """
    states = [line for line in wire if line["what"] == "state"]
    if not states:
        return None
    times_s = np.array([state["time_s"] for state in states])
    away_m = np.linalg.norm(
        np.array([state["position_m"] for state in states]) - states[-1]["position_m"], axis=1
    )
    if away_m[times_s > times_s[-1] - WATCHED_s].max() > STILL_m:
        return None
    moving = np.flatnonzero(away_m > REST_m)
    return max(float(times_s[moving[-1]]) - fault_s, 0.0) if len(moving) else 0.0
