"""How long before a failure the monitor stops: an episode beside its twin that nothing watches.

Both are the same until the first alarm, so the twin shows when the failure would have come.
"""

from collections.abc import Mapping
from dataclasses import replace

from benchmarks.stress.row import Row
from uniforce_vtla.evaluation.episode import (
    STEP_FIELDS,
    EpisodeTrace,
    ScoreLimits,
    excess_events,
    grasp_faults,
    slip_events,
)

EARLY_s = 0.5  # a warning that comes later is none


def first_event_s(trace: EpisodeTrace, limits: ScoreLimits) -> float | None:
    """Return when an episode first slipped, pressed too hard or let go; None: never."""
    if not _has_event(trace, limits):
        return None
    without, having = 0, len(trace.time_s)
    while having - without > 1:  # what has happened stays so: halve
        middle = (without + having) // 2
        without, having = (
            (without, middle) if _has_event(_until(trace, middle), limits) else (middle, having)
        )
    return round(float(trace.time_s[having - 1]), 3)


def _has_event(trace: EpisodeTrace, limits: ScoreLimits) -> bool:
    if len(trace.time_s) == 0:
        return False
    dropped = (trace.phase >= 1).any() and bool(grasp_faults(trace, limits))
    return dropped or bool(slip_events(trace, limits)) or bool(excess_events(trace, limits))


def _until(trace: EpisodeTrace, steps: int) -> EpisodeTrace:
    return replace(trace, **{name: getattr(trace, name)[:steps] for name in STEP_FIELDS})


def warned(watched: Mapping[int, Row], unwatched: Mapping[int, Row]) -> dict[str, int]:
    """Return what became of the scenes in which the unwatched twin failed.

    Returns:
        ``failures`` of the twin; of them ``warned`` early enough, and ``averted`` by a new
        reference.
    """
    pairs = [(watched[seed], row.event_s) for seed, row in unwatched.items() if seed in watched]
    failed = [(row, event_s) for row, event_s in pairs if event_s is not None]
    stopped = [
        row.ended_s <= event_s - EARLY_s for row, event_s in failed if row.outcome == "aborted"
    ]
    averted = [row.event_s is None for row, _ in failed if row.outcome != "aborted"]
    return {"failures": len(failed), "warned": sum(stopped), "averted": sum(averted)}
