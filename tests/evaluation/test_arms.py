"""Scores of arms, and the statistics they are compared with."""

from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uniforce_vtla.errors import ContractError
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, read_rows, table
from uniforce_vtla.evaluation.pictures import draw_arms
from uniforce_vtla.evaluation.statistics import mcnemar, wilson
from uniforce_vtla.keys import OUTCOME_NAMES
from uniforce_vtla.results_file import append_line


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
