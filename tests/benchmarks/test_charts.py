"""Charts: what lies on a front, and the tokenizer's chart at toy size."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.charts import __main__ as charts
from benchmarks.charts import contact, data, policy, scene
from benchmarks.charts.front import TIE, Point, front
from benchmarks.charts.tokenizer import PRECISIONS, running_in
from benchmarks.probes.labelled_set import FROZEN, SENSORS, draw_labelled
from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint, stored_config
from uniforce_vtla.evaluation.arms import ArmReport, EpisodeRow
from uniforce_vtla.tokenizer.api import Tokenizer

numbers = st.floats(0, 1, allow_nan=False)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12))
def test_the_cheapest_and_the_best_are_never_both_beaten(rows: list[tuple[float, float]]) -> None:
    points = [Point(str(k), cost, score, score, score) for k, (cost, score) in enumerate(rows)]
    kept = [point for point in points if point.name in front(points)]
    assert min(point.cost for point in kept) == min(point.cost for point in points)
    assert max(point.score for point in kept) >= max(point.score for point in points) - TIE


def test_slower_and_no_better_is_beaten() -> None:
    points = [
        Point("a", 1, 0.8, 0, 1),
        Point("b", 2, 0.8 + TIE / 2, 0, 1),
        Point("c", 3, 0.9, 0, 1),
    ]
    assert front(points) == ["a", "c"]


@pytest.mark.slow
def test_the_tokenizers_chart_at_toy_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = replace(FROZEN, sequences=2, length=3)
    drawn = {sensor: draw_labelled(recipe, sensor, 128) for sensor in SENSORS}
    monkeypatch.setattr(charts, "frozen_set", lambda name, config: drawn)
    assert charts.main(["rounds=1", f"out={tmp_path}"]) == 0
    found = json.loads((tmp_path / "chart_tokenizer.json").read_text())
    names = {point["name"] for point in found["points"]["zero_shot_v2"]}
    wanted = {f"{size}, {precision}" for size in ("small", "nano") for precision in PRECISIONS}
    assert names == wanted | {"small, no cache", "nano, no cache"}
    assert (
        found["pareto_front"]["fe_dev_v1"]
        and (tmp_path / "chart_tokenizer.png").stat().st_size > 5000
    )


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_precision_changes_latents_a_little_and_only_within_its_block(precision: str) -> None:
    tokenizer = Tokenizer.from_pretrained("nano")
    labelled = draw_labelled(replace(FROZEN, sequences=1, length=2), "tactip", 128)
    pair = labelled.reference[:1], labelled.frames[0]
    whole = tokenizer.encode(*pair)
    with running_in(tokenizer, precision):
        changed = tokenizer.encode(*pair).to(torch.float32)
    assert torch.equal(tokenizer.encode(*pair), whole)
    relative = float((changed - whole).norm() / whole.norm())
    assert (relative == 0) if precision == "float32" else (0 < relative < 0.3), relative


def test_a_policys_point_shares_a_call_among_the_steps_it_gives() -> None:
    rows = [
        EpisodeRow(
            seed,
            "success",
            seed > 0,
            False,
            False,
            0.0,
            6.0,
            8.0,
            13.0,
            think_p50_ms=24.0,
            think_p95_ms=30.0,
        )
        for seed in range(4)
    ]
    found = policy.point(ArmReport("executes 2", rows), 2, default=2)
    assert (found.name, found.cost, found.score, found.default) == ("2 of 16", 12.0, 0.75, True)
    assert found.low < 0.75 < found.high


def test_a_copied_checkpoint_executes_other_steps_and_is_whole(tmp_path: Path) -> None:
    folder = policy.executing(shipped_checkpoint(), 3, tmp_path / "three")
    assert stored_config(folder).n_action_steps == 3
    assert policy.executing(tmp_path / "absent", 3, folder) == folder  # kept from an earlier run


def test_a_part_of_the_demonstrations_takes_as_many_of_each_source() -> None:
    episodes = [{"source": source} for source in "aaabbb"]
    assert data.chosen(episodes, 4) == [0, 1, 3, 4]
    assert data.chosen(episodes, 3) == [0, 1, 3]
    assert data.chosen(episodes, 9) == list(range(6))


def test_the_data_chart_at_toy_size_holds_what_ran_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data, "pretrained", lambda run, name, seed: run.units)
    row = {"fz_r2_worst": -0.1}
    monkeypatch.setattr(
        data, "measure", lambda run, units, seed, real, facts: row | {"fz_r2": units / 1000}
    )
    for units in ("64,128", "256"):
        assert data.main(["part=pairs", f"units={units}", f"out={tmp_path}"]) == 0
    found = json.loads((tmp_path / "chart_data.json").read_text())["pairs"]
    assert [(one["name"], one["cost"], one["score"]) for one in found["points"]] == [
        ("256 units", 8192, 0.256)
    ]
    assert (
        found["pareto_front"] == ["256 units"]
        and (tmp_path / "chart_data_pairs.png").stat().st_size > 5000
    )


def test_demonstrations_need_a_view(capsys: pytest.CaptureFixture[str]) -> None:
    assert data.main([]) == 2
    assert "expected a training view's folder, got none" in capsys.readouterr().err


@pytest.mark.slow
def test_the_contact_chart_at_toy_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact, "SENSORS", ("tactip",))
    monkeypatch.setattr(contact, "CELLS_mm", (2.5, 5.0))
    assert contact.main(["contacts=2", "rounds=1", f"out={tmp_path}"]) == 0
    found = json.loads((tmp_path / "chart_contact.json").read_text())["sensors"]["tactip"]
    fine, coarse = found["points"]
    assert fine["default"] and not coarse["default"] and fine["score"] > coarse["score"] > 0
    assert (tmp_path / "chart_contact_tactip.png").stat().st_size > 5000


def test_the_scenes_points_are_what_was_rolled_out_and_presses_are_over_the_finest() -> None:
    times = {2: 20.0, 4: 10.0, 32: 1.0}
    settings = [
        {"substeps": n, "times_real_time": x, "press_N": [6.0 + 3 / n, 6.0]}
        for n, x in times.items()
    ]
    clean = {
        "V+T, 480 Hz": {"k": 3, "n": 4, "low": 0.3, "high": 0.9},
        "expert, 240 Hz": {"k": 0, "n": 4},
    }
    assert scene.points(settings, clean) == [Point("480 Hz", 100.0, 0.75, 0.3, 0.9, True)]
    coarse, usual, finest = scene.pressed(settings).values()
    assert coarse[0] > usual[0] > finest[0] == 1 and coarse[1] == 1


@pytest.mark.slow
def test_the_scene_chart_at_toy_size_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = [{"substeps": n, "times_real_time": 64 / n, "press_N": [6 + 1 / n]} for n in (4, 32)]
    monkeypatch.setattr(scene, "solvers", lambda asked, repeats: {"settings": settings})
    asked = ["substeps=4", "rollouts=1", "workers=1", f"out={tmp_path}"]
    assert scene.main(asked) == 0
    rows = (tmp_path / "chart_scene_20000.jsonl").read_text()
    assert scene.main(asked) == 0 and (tmp_path / "chart_scene_20000.jsonl").read_text() == rows
    clean = json.loads((tmp_path / "chart_scene.json").read_text())["clean"]
    assert {cell: share["n"] for cell, share in clean.items()} == dict.fromkeys(
        ("expert, 480 Hz", "V+T, 480 Hz", "V, 480 Hz"), 1
    )
