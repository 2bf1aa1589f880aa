"""The plan is consistent, and the committed table is what its letters say."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.wiping import draw_z_profiles
from benchmarks.wiping_plan import ARMS, AS_GOOD, BETTER, RECIPES
from uniforce_cli.score import SCRIPTS
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow, scores_of
from uniforce_vtla.evaluation.comparison import as_good, better
from uniforce_vtla.keys import OUTCOME_NAMES
from uniforce_vtla.sensors import list_sensors

TABLE = json.loads((Path(__file__).parents[2] / "docs/results/wiping.json").read_text())
ROW = EpisodeRow(0, "success", True, False, False, 0.05, 6.0, 7.0, 10.0, 20.0, 30.0)


def test_the_plan_names_every_arm_once_and_asks_only_about_those() -> None:
    names = [a.name for a in ARMS]
    assert len(set(names)) == len(names)
    asked = {name for pair in BETTER for name in pair} | {n for c in AS_GOOD for n in (c.first, c.second)}
    assert asked <= set(names)
    assert {a.left for a in ARMS} | {a.right for a in ARMS} <= set(list_sensors())
    assert {a.checkpoint for a in ARMS} == {*RECIPES, *SCRIPTS}


def test_a_swap_uses_its_partners_checkpoint() -> None:
    by_name = {a.name: a for a in ARMS}
    swaps = [claim for claim in AS_GOOD if "swapped" in claim.about]
    assert len(swaps) == 3
    for swap in swaps:
        assert by_name[swap.first].checkpoint == by_name[swap.second].checkpoint


def test_the_committed_table_adds_up() -> None:
    """Both seeds' scenes together are the arm's, for every arm of a policy."""
    for arm in (arm for arm in ARMS if arm.checkpoint not in SCRIPTS):
        names = [f"{seed}/{arm.checkpoint}" for seed in TABLE["checkpoints"]]
        parts = [scores_of(TABLE, name)["arms"][arm.name] for name in names]
        whole = TABLE["arms"][arm.name]
        assert sum(part["clean"] for part in parts) == whole["clean"]
        assert sum(part["success"] for part in parts) == whole["success"]
        assert [f"{part['clean']}/{part['n']}" for part in parts] == whole["clean_by_checkpoint"]


def test_the_committed_tests_follow_from_the_committed_letters() -> None:
    outcome = {name[0]: name for name in OUTCOME_NAMES} | {"C": "success"}
    reports = {
        name: ArmReport(
            name, [replace(ROW, seed=seed, outcome=outcome[c], clean=c == "C") for seed, c in enumerate(arm["by_seed"])]
        )
        for name, arm in TABLE["arms"].items()
    }
    for now, committed in ((better(reports, BETTER), TABLE["tests"]), (as_good(reports, AS_GOOD), TABLE["as_good"])):
        wanted = [{k: v for k, v in t.items() if k != "arms"} for t in committed]
        assert [{k: pytest.approx(v) for k, v in t.items() if k != "arms"} for t in now] == wanted


def test_profiles_are_drawn_also_where_an_arm_never_wiped(tmp_path: Path) -> None:
    wiped = ArmReport("V+T", [replace(ROW, z_profile_mm=tuple(float(z) for z in range(60)))] * 3)
    path = draw_z_profiles([wiped, ArmReport("V", [ROW])], tmp_path / "z.png")
    assert path.stat().st_size > 1000
    assert draw_z_profiles([ArmReport("V", [ROW])], tmp_path / "none.png").exists()
