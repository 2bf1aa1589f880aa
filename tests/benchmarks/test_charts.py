"""Charts: what lies on a front, and the tokenizer's chart at toy size."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.charts import __main__ as charts
from benchmarks.charts import policy
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
