"""The programs for a GPU box, at a small size on a CPU: what they count is exact, what they time is
there."""

import json
from itertools import product

import pytest
import torch

from benchmarks.policy import chart, latency, training_speed
from benchmarks.policy.network import build
from benchmarks.policy.training_speed import TrainingSpeedConfig, steps_of

PROGRAMS = (latency.main, chart.main, training_speed.main)


def run(main, out, size="small"):
    """Run a program with a small network; return what it wrote."""
    assert main([f"size={size}", "rounds=1", f"out={out}"]) == 0
    (file,) = out.glob("*.json")
    table = json.loads(file.read_text())
    assert table["device"] == "cpu" and {"commit", "dirty", "command"} <= table.keys()
    return table


def test_latency_and_its_parts(tmp_path):
    table = run(latency.main, tmp_path, "tiny")
    assert table["operations"]["fast"] <= 0.45 * table["operations"]["stock"]
    assert table["operations"]["stock_batched"] < table["operations"]["stock"]
    assert table["max_abs_difference"] < 1e-4 < table["largest_action"]
    assert table["floor"]["ms"] > 0 and table["floor"]["weight_bytes"] > 1e6
    parts = {"preprocessor", "cameras", "touch_to_latents", "postprocessor", "whole", "touch"}
    assert parts < table["end_to_end_ms"].keys()


def test_more_flow_steps_are_nearer_to_the_exact_chunk(tmp_path):
    table = run(chart.main, tmp_path)
    float32 = [row["rms"] for row in table["points"] if row["dtype"] == "float32"]
    assert len(table["points"]) == 2 * len(float32) and float32[-1] < 0.2 * float32[0]
    assert chart.main([f"drawn={tmp_path / 'chart.json'}"]) == 0
    assert (tmp_path / "chart.png").stat().st_size > 5000


def test_training_beside_stock(tmp_path):
    table = run(training_speed.main, tmp_path)
    run_rows = [row for row in table["rows"] if "batch" in row]
    settings = {(row["batch"], row["checkpointing"]) for row in run_rows}
    assert settings == {*product((1, 4), (False, True))}
    for row in run_rows:
        assert row["touch_over_stock"] > 0 and row["tokenizer_unchanged"]


def test_twenty_steps_of_bases_code_learn_touch_and_leave_the_tokenizer():
    """The code of ``base`` at reduced width."""
    config = TrainingSpeedConfig(size="small", rounds=19)
    row = steps_of(build("small", "cpu").train(), 1, config, learning_rate=1e-3)
    assert row["losses"]["touch"][-1] < 0.8 * row["losses"]["touch"][0]
    assert all(min(norms) > 0 for norms in row["gradient_norms"].values())
    assert row["tokenizer_unchanged"] and len(row["losses"]["touch"]) == 20


@pytest.mark.parametrize("main", PROGRAMS)
@pytest.mark.parametrize("given, says", [("size=huge", "base"), ("device=cuda", "CUDA")])
def test_what_is_not_there_is_said(main, given, says, refuses, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    refuses(main, [given], says)
