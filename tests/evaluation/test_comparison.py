"""The plan is consistent, and its questions are answered from paired rows alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, summarise
from uniforce_vtla.evaluation.comparison import as_good, better
from uniforce_vtla.evaluation.pictures import draw_z_profiles
from uniforce_vtla.evaluation.plan import ARMS, AS_GOOD, BETTER
from uniforce_vtla.sensors import list_sensors

ROW = EpisodeRow(0, "success", True, False, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0)


def arm(name: str, codes: str, first_seed: int = 0) -> ArmReport:
    """An arm whose letters say C (clean) or r (residual), seed by seed."""
    rows = [
        replace(ROW, seed=first_seed + i, outcome="success" if c == "C" else "residual", clean=c == "C")
        for i, c in enumerate(codes)
    ]
    return summarise(name, rows)


def test_the_plan_names_every_arm_once_and_asks_only_about_those() -> None:
    names = [a.name for a in ARMS]
    assert len(set(names)) == len(names)
    asked = {name for pair in BETTER for name in pair} | {n for c in AS_GOOD for n in (c.first, c.second)}
    assert asked <= set(names)
    assert {a.left for a in ARMS} | {a.right for a in ARMS} <= set(list_sensors())


def test_a_swap_uses_its_partners_checkpoint() -> None:
    by_name = {a.name: a for a in ARMS}
    swaps = [claim for claim in AS_GOOD if "swapped" in claim.about]
    assert len(swaps) == 3
    for swap in swaps:
        assert by_name[swap.first].checkpoint == by_name[swap.second].checkpoint


def test_a_clear_difference_survives_holm_and_an_arm_not_scored_is_not_asked_about() -> None:
    reports = {
        r.arm: r for r in (arm("V", "r" * 20), arm("V+T", "C" * 15 + "r" * 5), arm("V+G", "C" + "r" * 19))
    }
    tests = {tuple(t["arms"]): t for t in better(reports)}
    assert set(tests) == {("V+T", "V"), ("V+G", "V")}
    clear, none = tests["V+T", "V"], tests["V+G", "V"]
    assert clear["points"] == pytest.approx(75) and clear["p_holm"] < 0.001 < 0.5 < none["p_holm"]
    assert clear["anytime_decided_after"] < 15 and none["anytime_decided_after"] is None
    assert clear["p_holm"] == pytest.approx(2 * clear["p_value"])


def test_only_shared_seeds_are_compared() -> None:
    reports = {"V": arm("V", "rrrr"), "V+T": arm("V+T", "CCCC", first_seed=2)}
    assert better(reports)[0]["n"] == 2
    assert better({"V": arm("V", "r"), "V+T": arm("V+T", "C", first_seed=9)}) == []


def test_a_swap_is_as_good_only_when_shown() -> None:
    same = {"V+T": arm("V+T", "C" * 180 + "r" * 20), "V+G": arm("V+G", "C" * 178 + "r" * 22)}
    worse = same | {"V+G": arm("V+G", "C" * 150 + "r" * 50)}
    assert as_good(same)[0]["shown"] and not as_good(worse)[0]["shown"]


def test_one_letter_a_seed_tells_what_happened() -> None:
    slipped = replace(ROW, clean=False, slippage=True)
    report = summarise("V", [ROW, slipped, replace(ROW, outcome="failed_grasp", clean=False)])
    assert report.as_dict()["by_seed"] == "Csf"


def test_profiles_are_drawn_also_where_an_arm_never_wiped(tmp_path: Path) -> None:
    wiped = summarise("V+T", [replace(ROW, z_profile_mm=tuple(float(z) for z in range(60)))] * 3)
    path = draw_z_profiles([wiped, summarise("V", [ROW])], tmp_path / "z.png")
    assert path.stat().st_size > 1000
    assert draw_z_profiles([summarise("V", [ROW])], tmp_path / "none.png").exists()
