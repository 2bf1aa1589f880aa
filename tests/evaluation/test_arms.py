"""Scores of arms, and the statistics they are compared with."""

from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, read_rows, table
from uniforce_vtla.evaluation.comparison import AtMostWorse, as_good, better
from uniforce_vtla.evaluation.pictures import draw_arms
from uniforce_vtla.evaluation.statistics import holm, mcnemar, non_inferior, wilson
from uniforce_vtla.keys import OUTCOME_NAMES
from uniforce_vtla.results_file import append_line

PAIRS = (("V+T", "V"), ("V+G", "V"), ("V+U", "V"))


def row(seed, outcome="success", clean=True):
    return EpisodeRow(seed, outcome, clean, not clean, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0)


def arm(name, codes, first_seed=0):
    """An arm whose letters say C (clean) or r (residual), seed by seed."""
    outcomes = {"C": "success", "r": "residual"}
    return ArmReport(
        name, [row(first_seed + i, outcomes[c], c == "C") for i, c in enumerate(codes)]
    )


def clean(*reports):
    return {report.arm: report.clean_by_seed for report in reports}


def paired(only_first, only_second, both):
    """Clean success of two arms on the same seeds."""
    codes = [(True, False)] * only_first + [(False, True)] * only_second + [(True, True)] * both
    return zip(*codes, strict=True)


@given(st.lists(st.sampled_from(OUTCOME_NAMES), min_size=1, max_size=30))
def test_outcomes_sum_to_n(outcomes):
    report = ArmReport("V", [row(i, o, o == "success") for i, o in enumerate(outcomes)])
    assert sum(report.count(o) for o in OUTCOME_NAMES) == report.n
    assert report.as_dict()["clean"] == outcomes.count("success")


def test_rows_survive_a_line_cut_short(tmp_path):
    file = tmp_path / "episodes.jsonl"
    kept = {3: row(3), 4: row(4, "residual", False)}
    for finished in kept.values():
        append_line(file, asdict(finished))
    with file.open("a") as handle:
        handle.write('{"seed": 5, "outc')
    assert read_rows(file) == kept
    append_line(file, asdict(row(5)))  # scored again
    assert read_rows(file) == kept | {5: row(5)}


def test_rows_of_another_version_are_refused(tmp_path):
    file = tmp_path / "episodes.jsonl"
    file.write_text('{"seed": 5, "height": 2}\n')
    with pytest.raises(ContractError, match="another folder"):
        read_rows(file)


def test_table_and_picture_show_every_arm(tmp_path):
    reports = [arm("V", "r"), arm("V+T", "C")]
    text = table(reports)
    assert "| V | 0/1 = 0 %" in text and "| V+T | 1/1 = 100 %" in text
    assert draw_arms(reports, tmp_path / "arms.png", "t").stat().st_size > 1000


def test_one_letter_a_seed_says_what_happened():
    rows = [row(0), row(1, clean=False), row(2, "failed_grasp", clean=False)]
    assert ArmReport("V", rows).as_dict()["by_seed"] == "Csf"


def test_a_clear_difference_survives_holm_and_an_arm_not_scored_is_not_asked_about():
    arms = arm("V", "r" * 20), arm("V+T", "C" * 15 + "r" * 5), arm("V+G", "C" + "r" * 19)
    clear, none = better(clean(*arms), PAIRS)
    assert (clear["arms"], none["arms"]) == (["V+T", "V"], ["V+G", "V"])
    assert clear["points"] == pytest.approx(75) and clear["p_holm"] < 0.001 < 0.5 < none["p_holm"]
    assert clear["p_holm"] == pytest.approx(2 * clear["p_value"])


def test_only_shared_seeds_are_compared():
    arms = clean(arm("V", "rrrr"), arm("V+T", "CCCC", first_seed=2))
    assert better(arms, PAIRS)[0]["n"] == 2
    assert better({"V": {0: False}, "V+T": {9: True}}, PAIRS) == []


def test_a_swap_is_as_good_only_when_shown():
    claims = [AtMostWorse("swapped", "V+G", "V+T", 0.10)]
    reference = arm("V+T", "C" * 180 + "r" * 20)
    same = clean(reference, arm("V+G", "C" * 178 + "r" * 22))
    worse = clean(reference, arm("V+G", "C" * 150 + "r" * 50))
    assert as_good(same, claims)[0]["shown"] and not as_good(worse, claims)[0]["shown"]


def test_wilson_matches_the_published_example():
    # Newcombe 1998, table I: 81/263, Wilson without continuity correction: .2553 to .3662
    interval = wilson(81, 263)
    assert interval.low == pytest.approx(0.2553, abs=1e-4)
    assert interval.high == pytest.approx(0.3662, abs=1e-4)


def test_mcnemar_is_the_sign_test_on_discordant_pairs():
    test = mcnemar(*paired(9, 1, 5))
    assert (test.only_first, test.only_second) == (9, 1)
    assert test.p_value == pytest.approx(22 / 1024)  # 2·(1 + 10)/2^10


def test_impossible_numbers_are_refused():
    for k, n in ((1, 0), (-1, 5), (6, 5)):
        with pytest.raises(ContractError, match="0 ≤ k ≤ n"):
            wilson(k, n)
    with pytest.raises(ContractError, match="same seeds"):
        mcnemar([True], [True, False])
    for margin in (0.0, 1.0, -0.1):
        with pytest.raises(ContractError, match="margin"):
            non_inferior([True], [True], margin)


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
