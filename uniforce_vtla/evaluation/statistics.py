"""Intervals and paired tests for success counts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

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
