"""The report's questions that don't need minutes: errors that say what to do, and a user's own recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from uniforce_vtla.commands import peer_rows
from uniforce_vtla.commands.arguments import choose, parse
from uniforce_vtla.commands.tokenizer_report import TokenizerReportCommand, main
from uniforce_vtla.probes.zero_shot import Table
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.model import TokenizerConfig


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


def test_every_row_can_be_named_on_the_command_line() -> None:
    tokenizer = Tokenizer.random(TokenizerConfig(width=16, depth=1, heads=2))
    makers = peer_rows.trained(Table({}, {}), tokenizer, 1, 1)
    for name in makers:
        assert list(choose(makers, name)) == [name]  # and no comma
        assert parse(TokenizerReportCommand, [f"only=mean,{name}"]).only == f"mean,{name}"
        assert parse(TokenizerReportCommand, [f"only={name}"]).only == name  # no YAML hides in it
