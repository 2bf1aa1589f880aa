"""Arms on the same seeds: which one is better, which one is at most a margin worse."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import optimize, stats

from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.evaluation.arms import Clean, CleanBySeed, paired_clean
from uniforce_vtla.evaluation.statistics import discordant, mcnemar

Pairs = Sequence[tuple[str, str]]


@dataclass(frozen=True)
class AtMostWorse:
    """The claim that ``first`` is clean at most ``margin`` (a share) less often than ``second``."""

    about: str
    first: str
    second: str
    margin: float


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


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for the family of claims (Holm 1979)."""
    order = np.argsort(p_values, kind="stable")
    factors = len(p_values) - np.arange(len(p_values))
    adjusted = np.minimum(np.maximum.accumulate(np.asarray(p_values)[order] * factors), 1.0)
    result = np.empty(len(p_values))
    result[order] = adjusted
    return result.tolist()


@dataclass(frozen=True)
class NonInferiority:
    """Whether an arm is at most ``margin`` worse than its reference.

    ``difference`` is new − reference; ``lower`` its one-sided 95 % bound; ``p_value`` of the null.
    """

    difference: float
    lower: float
    margin: float
    p_value: float

    @property
    def shown(self) -> bool:
        """The bound lies above −margin."""
        return self.lower > -self.margin


def non_inferior(
    new: Sequence[bool], reference: Sequence[bool], margin: float, confidence: float = 0.95
) -> NonInferiority:
    """Return the paired score test of non-inferiority and its one-sided bound (Tango 1998).

    Raises ContractError: no seed, unequal numbers of seeds, or a margin outside (0, 1).
    """
    only_new, only_reference = discordant(new, reference)
    n = len(new)
    if n == 0 or not 0 < margin < 1:
        came = f"{n} seeds, margin {margin}"
        raise ContractError(
            expected("non-inferiority", "1+ seeds, margin in (0, 1)", came, "Adapt.")
        )
    quantile = float(stats.norm.ppf(confidence))

    def excess(delta: float) -> float:
        return _tango(only_new, only_reference, n, delta) - quantile

    least = -1 + 1e-9
    lower = -1.0
    if excess(least) >= 0:
        lower = float(optimize.brentq(excess, least, 1 - 1e-9))
    z = _tango(only_new, only_reference, n, -margin)
    return NonInferiority((only_new - only_reference) / n, lower, margin, float(stats.norm.sf(z)))


def _tango(only_new: int, only_reference: int, n: int, delta: float) -> float:
    """Return the score statistic for a true difference ``delta`` (Tango 1998, eq. 14).

    At 0 it is McNemar's z.
    """
    b = -only_new - only_reference + (2 * n - only_new + only_reference) * delta
    c = -only_reference * delta * (1 - delta)
    q = (math.sqrt(max(b * b - 8 * n * c, 0.0)) - b) / (4 * n)
    variance = n * (2 * q + delta * (1 - delta))
    shift = only_new - only_reference - n * delta
    if variance > 1e-12:
        return shift / math.sqrt(variance)
    if shift == 0:
        return 0.0
    return math.copysign(math.inf, shift)
