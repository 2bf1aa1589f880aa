"""Intervals and paired tests for success counts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from uniforce_vtla.errors import ContractError, expected


@dataclass(frozen=True)
class Proportion:
    """k successes of n with a 95 % Wilson interval; prints as ``k/n = p % [low, high]``."""

    k: int
    n: int
    low: float
    high: float

    def __str__(self) -> str:
        rate = 100 * self.k / self.n
        return f"{self.k}/{self.n} = {rate:.0f} % [{100 * self.low:.0f}, {100 * self.high:.0f}]"


def wilson(k: int, n: int, confidence: float = 0.95) -> Proportion:
    """Return the Wilson score interval of k successes in n trials (Wilson 1927).

    Raises ContractError: n < 1, or k outside 0…n.
    """
    if n < 1 or not 0 <= k <= n:
        raise ContractError(
            expected("k, n", "0 ≤ k ≤ n, n ≥ 1", f"{k}, {n}", "Roll out at least once.")
        )
    interval = stats.binomtest(k, n).proportion_ci(confidence, method="wilson")
    return Proportion(k, n, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class PairedTest:
    """Exact McNemar test of two arms on the same seeds."""

    only_first: int
    only_second: int
    p_value: float


def mcnemar(first: Sequence[bool], second: Sequence[bool]) -> PairedTest:
    """Return the exact two-sided McNemar test of paired successes (McNemar 1947).

    Raises ContractError: the two arms do not have the same number of seeds.
    """
    only_first, only_second = discordant(first, second)
    total = only_first + only_second
    if total == 0:
        return PairedTest(0, 0, 1.0)
    return PairedTest(only_first, only_second, float(stats.binomtest(only_first, total).pvalue))


def discordant(first: Sequence[bool], second: Sequence[bool]) -> tuple[int, int]:
    """Return on how many seeds only the first, and only the second, succeeded.

    Raises ContractError: the two arms do not have the same number of seeds.
    """
    if len(first) != len(second):
        do = "Use the same seeds."
        raise ContractError(
            expected("paired arms", f"{len(first)} seeds", f"{len(second)} seeds", do)
        )
    one = np.asarray(first, dtype=bool)
    two = np.asarray(second, dtype=bool)
    return int((one & ~two).sum()), int((two & ~one).sum())


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
