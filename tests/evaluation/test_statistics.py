import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.statistics import anytime, holm, mcnemar, non_inferior, wilson


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


def test_impossible_numbers_are_refused() -> None:
    for k, n in ((1, 0), (-1, 5), (6, 5)):
        with pytest.raises(ContractError, match="0 ≤ k ≤ n"):
            wilson(k, n)
    with pytest.raises(ContractError, match="same seeds"):
        mcnemar([True], [True, False])
    for margin in (0.0, 1.0, -0.1):
        with pytest.raises(ContractError, match="margin"):
            non_inferior([True], [True], margin)


def test_holm_steps_down_and_stays_monotone() -> None:
    # Holm 1979: the smallest of three is tripled, the next doubled, and none falls below the one before it
    assert holm([0.03, 0.01, 0.04]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([]) == []


def arms(only_first: int, only_second: int, both: int) -> tuple[list[bool], list[bool]]:
    first = [True] * only_first + [False] * only_second + [True] * both
    second = [False] * only_first + [True] * only_second + [True] * both
    return first, second


def test_wealth_of_one_won_bet_is_the_mixtures_mean() -> None:
    # 2 ∫ over (½, 1) of θ/½ = 3/2; a loss pays 2 ∫ (1 − θ)/½ = 1/2
    assert anytime([True], [False]).evidence == pytest.approx(1.5)
    assert anytime([False], [True]).evidence == pytest.approx(0.5)
    assert anytime([True, False], [True, False]).evidence == pytest.approx(1.0)


def test_anytime_decides_early_on_a_clear_difference_and_remembers_it() -> None:
    first, second = arms(12, 0, 0)
    test = anytime(first, second)
    assert test.decided_after is not None and test.decided_after <= 8
    later = anytime(first + [False] * 12, second + [True] * 12)
    assert later.p_value == pytest.approx(test.p_value) and later.evidence < test.evidence


def test_looking_after_every_seed_raises_no_false_alarm_beyond_alpha() -> None:
    rng = np.random.default_rng(0)
    trials = 400
    alarms = [anytime(list(rng.random(300) < 0.5), list(rng.random(300) < 0.5)).p_value <= 0.05 for _ in range(trials)]
    assert sum(alarms) <= 0.05 * trials + 3 * np.sqrt(0.05 * 0.95 * trials)


def test_score_bound_at_zero_is_mcnemars_z() -> None:
    first, second = arms(25, 9, 66)
    z = (25 - 9) / np.sqrt(25 + 9)
    # a bound at the confidence that z reaches lies exactly at no difference
    bound = non_inferior(first, second, 0.1, confidence=float(stats.norm.cdf(z)))
    assert bound.lower == pytest.approx(0.0, abs=1e-6)


def test_the_bound_covers_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    n, truth, hits, trials = 100, 0.1 - 0.2, 0, 400
    for _ in range(trials):
        case = rng.choice(3, size=n, p=[0.1, 0.2, 0.7])  # only new, only reference, both
        bound = non_inferior(list(case != 1), list(case != 0), 0.1).lower
        hits += bound <= truth
    assert abs(hits / trials - 0.95) < 3 * np.sqrt(0.05 * 0.95 / trials) + 0.01


def test_equal_arms_are_non_inferior_only_with_enough_seeds() -> None:
    assert non_inferior([True] * 200, [True] * 200, 0.1).shown
    assert not non_inferior([True] * 10, [True] * 10, 0.1).shown
    worse = non_inferior(*arms(5, 45, 150), 0.1)
    assert not worse.shown and worse.difference == pytest.approx(-0.2) and worse.p_value > 0.9


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_bound_lies_below_the_difference_and_agrees_with_its_p(pairs: list[tuple[bool, bool]]) -> None:
    new, reference = [a for a, _ in pairs], [b for _, b in pairs]
    found = non_inferior(new, reference, 0.1)
    assert -1 <= found.lower <= found.difference + 1e-9
    assert found.shown == (found.p_value < 0.05)
