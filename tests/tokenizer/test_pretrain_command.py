from __future__ import annotations

from pathlib import Path

import pytest

from uniforce_cli.pretrain import main
from uniforce_vtla.tokenizer.api import Tokenizer

SMALL = [
    "run.model.side=32",
    "run.model.patch=8",
    "run.model.width=16",
    "run.model.heads=2",
    "run.data.side=32",
    "run.data.units=2",
    "run.data.units_per_shard=1",
    "run.data.pairs_per_unit=2",
    "run.pairs_per_unit=2",
]


def run(folder: Path, *more: str) -> int:
    return main([*SMALL, f"cache={folder / 'pairs'}", f"out={folder / 'out'}", *more])


def test_command_trains_continues_and_leaves_a_loadable_tokenizer(tmp_path: Path) -> None:
    assert run(tmp_path, "run.steps=2") == 0
    first = Tokenizer.from_pretrained(tmp_path / "out" / "tokenizer").hash
    assert run(tmp_path, "run.steps=3") == 0
    assert Tokenizer.from_pretrained(tmp_path / "out" / "tokenizer").hash != first
    assert len((tmp_path / "out" / "log.csv").read_text().splitlines()) == 4


def test_a_cache_of_another_recipe_is_a_plain_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, "run.steps=1") == 0
    assert run(tmp_path, "run.steps=2", "run.data.seed=5") == 2
    assert "another folder" in capsys.readouterr().err
