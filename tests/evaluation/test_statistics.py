from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.statistics import mcnemar, wilson


def test_wilson_matches_the_published_example() -> None:
    # Newcombe 1998, table I: 81/263, Wilson without continuity correction: .2553 to .3662
    interval = wilson(81, 263)
    assert interval.low == pytest.approx(0.2553, abs=1e-4)
    assert interval.high == pytest.approx(0.3662, abs=1e-4)


def test_mcnemar_is_the_sign_test_on_discordant_pairs() -> None:
    first = [True] * 9 + [False] * 1 + [True] * 5
    second = [False] * 9 + [True] * 1 + [True] * 5
    test = mcnemar(first, second)
    assert (test.only_first, test.only_second) == (9, 1)
    assert test.p_value == pytest.approx(22 / 1024)  # 2·(1 + 10)/2^10


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_contains_the_rate_and_stays_in_bounds(kn: tuple[int, int]) -> None:
    k, n = kn
    interval = wilson(k, n)
    assert -1e-12 <= interval.low <= k / n + 1e-12
    assert k / n - 1e-12 <= interval.high <= 1 + 1e-12


@pytest.mark.parametrize(("k", "n"), [(1, 0), (-1, 5), (6, 5)])
def test_impossible_counts_are_refused(k: int, n: int) -> None:
    with pytest.raises(ContractError, match="0 ≤ k ≤ n"):
        wilson(k, n)


def test_unpaired_arms_are_refused() -> None:
    with pytest.raises(ContractError, match="same seeds"):
        mcnemar([True], [True, False])
