"""The benches: what they count is exact and held to the bar; what they time is only asked to be there."""

import json
from pathlib import Path

import pytest

from benchmarks import policy_speed
from benchmarks.policy.latency import CASES, BenchCase, bench_case
from benchmarks.policy.touch import bench_training
from benchmarks.policy_speed import main
from lerobot_policy_pi05_uniforce.configuration_pi05_uniforce import TinySettings

SMALL = {"tiny": TinySettings(width=64, depth=2, mlp_dim=32)}


def test_a_tiny_call_takes_at_most_two_fifths_of_the_operations() -> None:
    report = bench_case(CASES["tiny"], "cpu", rounds=1, steps=10)
    assert report["operations_share"] <= 0.40
    assert report["max_abs_difference"] < 1e-4
    assert min(report["floor_ms"], report["fast_ms"]) > 0


def test_the_command_writes_its_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        policy_speed.CASES, "tiny", BenchCase("tiny", missing=1, prompt=12, settings=SMALL)
    )
    assert main(["only=tiny", "rounds=2", "steps=2", f"out={tmp_path}"]) == 0
    table = json.loads((tmp_path / "policy_latency.json").read_text())
    assert table["gpu"] == "not run" and table["cpu"]["stock_ms"] > 0
    assert table["cases"]["tiny"]["cameras"] == 2


def test_twenty_steps_of_bases_code_learn_touch_and_leave_the_tokenizer() -> None:
    """The code of ``base`` at reduced width; at full size it runs on a GPU (docs/results/policy_latency.json)."""
    small = BenchCase("small", prompt=12, settings=SMALL)
    report = bench_training(small, "cpu", steps=20, learning_rate=1e-3)
    assert report["losses"][-1] < 0.8 * report["losses"][0]
    assert all(min(norms) > 0 for norms in report["gradient_norms"].values())
    assert report["tokenizer_unchanged"] and report["steps"] == 20 == len(report["losses"])


@pytest.mark.parametrize(
    ("given", "says"), [("only=huge", "base_3_cameras"), ("device=cuda", "CUDA")]
)
def test_what_is_not_there_is_said(
    given: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import torch

    if given == "device=cuda" and torch.cuda.is_available():
        pytest.skip("a CUDA device is here")
    assert main([given]) == 2
    assert says in capsys.readouterr().err
