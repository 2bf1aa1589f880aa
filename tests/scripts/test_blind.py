"""Expert and blind scripts on the same seeds, in one result file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.blind import main

ONE = ["level=easy", "episodes=1", "workers=1"]
NO_BLIND = ["press_N=[]", "grip_open_N=[]", "grip_relative_N=[]"]


def test_the_best_blind_script_is_named(tmp_path: Path) -> None:
    given = [*ONE, "experts=[]", "press_N=[5.0]", "grip_open_N=[]", "grip_relative_N=[6.5]"]
    assert main([*given, f"out={tmp_path / 'blind.json'}"]) == 0
    written = json.loads((tmp_path / "blind.json").read_text())
    assert list(written["scripts"]) == [written["best_blind"]] == ["measured_relative_press5_grip6.5"]


def test_experts_alone_have_no_best_blind_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ONE, *NO_BLIND, "experts=[both]", f"out={tmp_path / 'blind.json'}"]) == 0
    written = json.loads((tmp_path / "blind.json").read_text())
    assert written["best_blind"] is None and written["scripts"]["expert_both"]["clean"] == 1
    assert "best blind: none asked for" in capsys.readouterr().out
