"""When the arm came to rest, by its own log of a thousand states a second; the recorder isn't asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SLOW_m_s = 0.03  # half the speed of the circle: below it for good, the arm's target has stopped and it brakes
SPAN_s = 0.02  # a speed is measured over
REST_m = 1e-3  # so near to where it ends the arm rests
STILL_m = 5e-4  # how far it may still creep
WATCHED_s = 0.3  # at the end


@dataclass(frozen=True)
class Hold:
    """How an arm came to rest after a fault, seconds from the fault.

    Attributes:
        held_s: until it began to brake for good: its target had stopped.
        rest_s: until it was within 1 mm of where it stayed, braking included.
    """

    held_s: float
    rest_s: float

    def after_fault(self) -> Hold:
        """Return the same, 0 for what was so before the fault."""
        return Hold(max(self.held_s, 0.0), max(self.rest_s, 0.0))

    def as_dict(self) -> dict[str, float]:
        """Return the numbers as findings have them."""
        return {"hold_s": round(self.held_s, 3), "rest_s": round(self.rest_s, 3)}


def find_hold(wire: Sequence[dict], fault_s: float) -> Hold | None:
    """Return when the arm was held; None where it went on moving.

    Args:
        wire: the arm's log from the fault until well after the rest.
        fault_s: when it was broken, ``time.monotonic``.
    """
    states = [line for line in wire if line["what"] == "state"]
    if not states:
        return None
    times_s = np.array([state["time_s"] for state in states])
    places_m = np.array([state["position_m"] for state in states])
    away_m = np.linalg.norm(places_m - places_m[-1], axis=1)
    if away_m[times_s > times_s[-1] - WATCHED_s].max() > STILL_m:
        return None
    fast = _speeds_m_s(times_s, places_m) > SLOW_m_s
    return Hold(_last(times_s, fast) - fault_s, _last(times_s, away_m > REST_m) - fault_s).after_fault()


def _speeds_m_s(times_s: np.ndarray, places_m: np.ndarray) -> np.ndarray:
    before = np.searchsorted(times_s, times_s - SPAN_s)
    span_s = np.maximum(times_s - times_s[before], SPAN_s / 2)
    speeds: np.ndarray = np.linalg.norm(places_m - places_m[before], axis=1) / span_s
    return speeds


def _last(times_s: np.ndarray, is_so: np.ndarray) -> float:
    """Return the last time something was so; minus infinity where it never was."""
    moments = np.flatnonzero(is_so)
    return float(times_s[moments[-1]]) if len(moments) else -np.inf


def arm_clock(wire: Sequence[dict]) -> float | None:
    """Return the milliseconds the arm lived through per millisecond of ours; None without a log.

    The stand-in waits for its client. Where the machine starves one of them the arm's time runs slower than ours, its
    braking included; 1.0 means that a hold was measured on an arm that keeps time.
    """
    states = [line for line in wire if line["what"] == "state"]
    if len(states) < 2:
        return None
    lived_s = (states[-1]["id"] - states[0]["id"]) / 1000
    return round(lived_s / (states[-1]["time_s"] - states[0]["time_s"]), 3)
