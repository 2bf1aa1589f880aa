"""LeRobot's own help text shows this policy's settings: argparse chokes on a lone % in a comment."""

from __future__ import annotations

import sys

import pytest
from lerobot.scripts import lerobot_train

import lerobot_policy_pi05_uniforce  # noqa: F401  (registers the policy)


def test_lerobot_train_help_names_our_settings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["lerobot-train", "--policy.type=pi05_uniforce", "--help"])
    with pytest.raises(SystemExit) as stop:
        lerobot_train.main()
    assert stop.value.code in (0, None) and "touch_slots" in capsys.readouterr().out
