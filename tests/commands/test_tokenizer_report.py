"""The report's questions that don't need minutes: errors that say what to do, and a user's own recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from uniforce_vtla.commands.tokenizer_report import main


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["set=easy"], "hetero_hard_v1"),
        (["question=why"], "reconstructions"),
        (["data=/nowhere"], "nowhere"),
    ],
)
def test_bad_input_is_a_plain_message(
    arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, f"results={tmp_path}", f"cache={tmp_path}"]) == 2
    assert says in capsys.readouterr().out


def test_a_table_needs_a_frozen_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["set=hetero_hard_v1", f"results={tmp_path}", f"cache={tmp_path}"]) == 2
    assert "freeze=true" in capsys.readouterr().out
