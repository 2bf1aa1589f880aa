"""How long calls take: several in turns, so that a busy machine slows all alike."""

from collections.abc import Callable, Mapping, Sequence
from statistics import median


def in_turns[Call: Callable, Taken](
    calls: Mapping[str, Call], rounds: int, measure: Callable[[Call], Taken]
) -> dict[str, list[Taken]]:
    """Return what ``measure`` says of every call, round by round, after each was called once for its caches."""
    for call in calls.values():
        call()
    taken: dict[str, list[Taken]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            taken[name].append(measure(call))
    return taken


def ratio(times: Sequence[float], base: Sequence[float]) -> float:
    """Return the median over rounds of a time over another one of the same round."""
    return median(a / b for a, b in zip(times, base, strict=True))
