"""The ladder's comparison of arms: better, or shown to be at most a margin worse."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from benchmarks.ladder.comparison import AtMostWorse, as_good, better, holm, non_inferior
from uniforce_vtla.errors import ContractError

PAIRS = (("V+T", "V"), ("V+G", "V"), ("V+U", "V"))


def clean(arms):
    """Clean success by seed of arms whose letters say C (clean) or r (residual)."""
    return {name: dict(enumerate(code == "C" for code in codes)) for name, codes in arms.items()}


def paired(only_first, only_second, both):
    """Clean success of two arms on the same seeds."""
    codes = [(True, False)] * only_first + [(False, True)] * only_second + [(True, True)] * both
    return zip(*codes, strict=True)


def test_a_clear_difference_survives_holm_and_an_arm_not_scored_is_not_asked_about():
    arms = clean({"V": "r" * 20, "V+T": "C" * 15 + "r" * 5, "V+G": "C" + "r" * 19})
    clear, none = better(arms, PAIRS)
    assert (clear["arms"], none["arms"]) == (["V+T", "V"], ["V+G", "V"])
    assert clear["points"] == pytest.approx(75) and clear["p_holm"] < 0.001 < 0.5 < none["p_holm"]
    assert clear["p_holm"] == pytest.approx(2 * clear["p_value"])


def test_only_shared_seeds_are_compared():
    arms = {"V": dict.fromkeys(range(4), False), "V+T": dict.fromkeys(range(2, 6), True)}
    assert better(arms, PAIRS)[0]["n"] == 2
    assert better({"V": {0: False}, "V+T": {9: True}}, PAIRS) == []


def test_a_swap_is_as_good_only_when_shown():
    claims = [AtMostWorse("swapped", "V+G", "V+T", 0.10)]
    reference = {"V+T": "C" * 180 + "r" * 20}
    same = clean(reference | {"V+G": "C" * 178 + "r" * 22})
    worse = clean(reference | {"V+G": "C" * 150 + "r" * 50})
    assert as_good(same, claims)[0]["shown"] and not as_good(worse, claims)[0]["shown"]


def test_holm_steps_down_and_stays_monotone():
    # Holm 1979: the smallest of three is tripled, the next doubled, and none falls below the one
    # before it
    assert holm([0.03, 0.01, 0.04]) == pytest.approx([0.06, 0.03, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([]) == []


def test_score_bound_at_zero_is_mcnemars_z():
    z = (25 - 9) / np.sqrt(25 + 9)
    # a bound at the confidence that z reaches lies exactly at no difference
    confidence = float(stats.norm.cdf(z))
    bound = non_inferior(*paired(25, 9, 66), 0.1, confidence)
    assert bound.lower == pytest.approx(0.0, abs=1e-6)


def test_the_bound_covers_as_often_as_it_says():
    rng = np.random.default_rng(1)
    n, truth, hits, trials = 100, 0.1 - 0.2, 0, 400
    for _ in range(trials):
        case = rng.choice(3, size=n, p=[0.1, 0.2, 0.7])  # only new, only reference, both
        bound = non_inferior(list(case != 1), list(case != 0), 0.1).lower
        hits += bound <= truth
    assert abs(hits / trials - 0.95) < 3 * np.sqrt(0.05 * 0.95 / trials) + 0.01


def test_equal_arms_are_non_inferior_only_with_enough_seeds():
    assert non_inferior(*paired(0, 0, 200), 0.1).shown
    assert not non_inferior(*paired(0, 0, 10), 0.1).shown
    worse = non_inferior(*paired(5, 45, 150), 0.1)
    assert not worse.shown and worse.difference == pytest.approx(-0.2) and worse.p_value > 0.9


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_bound_lies_below_the_difference_and_agrees_with_its_p(pairs):
    found = non_inferior(*zip(*pairs, strict=True), 0.1)
    assert -1 <= found.lower <= found.difference + 1e-9
    assert found.shown == (found.p_value < 0.05)


def test_impossible_margins_are_refused():
    for margin in (0.0, 1.0, -0.1):
        with pytest.raises(ContractError, match="margin"):
            non_inferior([True], [True], margin)
