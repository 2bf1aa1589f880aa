"""When the arm came to rest, by its own log of a thousand states a second; the recorder isn't asked."""

from collections.abc import Sequence

import numpy as np

SLOW_m_s = 0.03  # half the speed of the circle: below it for good, the arm's target has stopped and it brakes
SPAN_s = 0.02  # a speed is measured over
REST_m = 1e-3  # so near to where it ends the arm rests
STILL_m = 5e-4  # how far it may still creep
WATCHED_s = 0.3  # at the end


def find_hold(wire: Sequence[dict], fault_s: float) -> dict[str, float] | None:
    """Return {"hold_s": until it began to brake for good, "rest_s": until it was within 1 mm of where it stayed}.

    Seconds from the fault at ``fault_s``, ``time.monotonic``, 0 for what was so before it; None where the arm went on
    moving. ``wire`` is the arm's log from the fault until well after the rest.
    """
    states = [line for line in wire if line["what"] == "state"]
    if not states:
        return None
    times_s = np.array([state["time_s"] for state in states])
    places_m = np.array([state["position_m"] for state in states])
    away_m = np.linalg.norm(places_m - places_m[-1], axis=1)
    if away_m[times_s > times_s[-1] - WATCHED_s].max() > STILL_m:
        return None
    moments = {"hold_s": _speeds_m_s(times_s, places_m) > SLOW_m_s, "rest_s": away_m > REST_m}
    lasts_s = {name: times_s[is_so].max(initial=fault_s) for name, is_so in moments.items()}
    return {name: round(float(last_s) - fault_s, 3) for name, last_s in lasts_s.items()}


def _speeds_m_s(times_s: np.ndarray, places_m: np.ndarray) -> np.ndarray:
    before = np.searchsorted(times_s, times_s - SPAN_s)
    span_s = np.maximum(times_s - times_s[before], SPAN_s / 2)
    speeds: np.ndarray = np.linalg.norm(places_m - places_m[before], axis=1) / span_s
    return speeds


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
