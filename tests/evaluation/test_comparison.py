"""Questions about arms are answered from paired rows alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, summarise
from uniforce_vtla.evaluation.comparison import AtMostWorse, as_good, better

ROW = EpisodeRow(0, "success", True, False, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0)
PAIRS = (("V+T", "V"), ("V+G", "V"), ("V+U", "V"))


def arm(name: str, codes: str, first_seed: int = 0) -> ArmReport:
    """An arm whose letters say C (clean) or r (residual), seed by seed."""
    rows = [
        replace(ROW, seed=first_seed + i, outcome="success" if c == "C" else "residual", clean=c == "C")
        for i, c in enumerate(codes)
    ]
    return summarise(name, rows)


def test_a_clear_difference_survives_holm_and_an_arm_not_scored_is_not_asked_about() -> None:
    reports = {
        r.arm: r for r in (arm("V", "r" * 20), arm("V+T", "C" * 15 + "r" * 5), arm("V+G", "C" + "r" * 19))
    }
    tests = {tuple(t["arms"]): t for t in better(reports, PAIRS)}
    assert set(tests) == {("V+T", "V"), ("V+G", "V")}
    clear, none = tests["V+T", "V"], tests["V+G", "V"]
    assert clear["points"] == pytest.approx(75) and clear["p_holm"] < 0.001 < 0.5 < none["p_holm"]
    assert clear["anytime_decided_after"] < 15 and none["anytime_decided_after"] is None
    assert clear["p_holm"] == pytest.approx(2 * clear["p_value"])


def test_only_shared_seeds_are_compared() -> None:
    reports = {"V": arm("V", "rrrr"), "V+T": arm("V+T", "CCCC", first_seed=2)}
    assert better(reports, PAIRS)[0]["n"] == 2
    assert better({"V": arm("V", "r"), "V+T": arm("V+T", "C", first_seed=9)}, PAIRS) == []


def test_a_swap_is_as_good_only_when_shown() -> None:
    claims = [AtMostWorse("swapped", "V+G", "V+T", 0.10)]
    same = {"V+T": arm("V+T", "C" * 180 + "r" * 20), "V+G": arm("V+G", "C" * 178 + "r" * 22)}
    worse = same | {"V+G": arm("V+G", "C" * 150 + "r" * 50)}
    assert as_good(same, claims)[0]["shown"] and not as_good(worse, claims)[0]["shown"]
