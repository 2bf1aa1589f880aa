"""Arms on the same seeds: which one is better, which one is at most a margin worse."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from uniforce_vtla.evaluation.statistics import holm, mcnemar, non_inferior

Pairs = Sequence[tuple[str, str]]
Clean = list[bool]  # clean success, seed by seed
CleanBySeed = Mapping[int, bool]  # of one arm


@dataclass(frozen=True)
class AtMostWorse:
    """The claim that ``first`` is clean at most ``margin`` (a share) less often than ``second``."""

    about: str
    first: str
    second: str
    margin: float


def paired_clean(first: CleanBySeed, second: CleanBySeed) -> tuple[Clean, Clean]:
    """Return clean success of both arms on the seeds they share, in the order of the seeds."""
    seeds = sorted(first.keys() & second.keys())
    return [first[s] for s in seeds], [second[s] for s in seeds]


def _scored(
    arms: Mapping[str, CleanBySeed], pairs: Pairs
) -> Iterator[tuple[dict[str, Any], Clean, Clean]]:
    """Yield, per pair of arms with shared seeds, their names and both arms' clean successes."""
    for first, second in pairs:
        if first in arms and second in arms:
            one, two = paired_clean(arms[first], arms[second])
            if one:
                yield {"arms": [first, second], "n": len(one)}, one, two


def difference(one: Clean, two: Clean) -> dict[str, Any]:
    """Return exact McNemar of two arms, and by how many percentage points the first is better."""
    return asdict(mcnemar(one, two)) | {"points": 100 * (sum(one) - sum(two)) / len(one)}


def better(arms: Mapping[str, CleanBySeed], pairs: Pairs) -> list[dict[str, Any]]:
    """Return, per pair scored on shared seeds, exact McNemar, Holm over the family."""
    tests = [pair | difference(one, two) for pair, one, two in _scored(arms, pairs)]
    for test, adjusted in zip(tests, holm([test["p_value"] for test in tests]), strict=True):
        test["p_holm"] = adjusted
    return tests


def as_good(arms: Mapping[str, CleanBySeed], claims: Sequence[AtMostWorse]) -> list[dict[str, Any]]:
    """Return, per claim about arms with shared seeds, whether non-inferiority is shown."""
    tests = []
    for claim in claims:
        for pair, one, two in _scored(arms, [(claim.first, claim.second)]):
            found = non_inferior(one, two, claim.margin)
            tests.append({"about": claim.about} | pair | asdict(found) | {"shown": found.shown})
    return tests
