"""Every verb and benchmark: a help text that teaches by example, quickly; nothing else is installed."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

from benchmarks.trust.command_line import MODULES
from uniforce_cli import main as command

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", sorted(MODULES))
def test_help_teaches_with_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.suppress(SystemExit):
        importlib.import_module(MODULES[name]).main(["--help"])
    said = capsys.readouterr().out
    assert ("uniforce " if name in command.VERBS else "python -m benchmarks.") + name in said


def test_one_command_is_installed_and_names_all_its_verbs(capsys: pytest.CaptureFixture[str]) -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert list(scripts) == ["uniforce"] and len(command.VERBS) <= 14
    assert command.main([]) == 0
    said = capsys.readouterr().out
    assert all(f"  {verb} " in said for verb in command.VERBS)
    assert command.main(["scoer"]) == 2 and "Did you mean score?" in capsys.readouterr().err


def test_the_overview_takes_less_than_a_second() -> None:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "uniforce_cli.main", "--help"], check=True, capture_output=True)
    assert time.perf_counter() - start < 1.0


def test_scripts_hold_no_logic_and_shadow_no_library() -> None:
    found = sorted((ROOT / "scripts").glob("*.py"))
    assert [script.name for script in found] == ["record.py", "score.py", "train.py"]
    for script in found:
        assert len(script.read_text().splitlines()) <= 12, script.name
        found_at = importlib.util.find_spec(script.stem)
        assert found_at is None or found_at.origin == str(script), f"{script.name} would shadow a library"


def test_key_value_reaches_the_config() -> None:
    from uniforce_cli.score import ScoreConfig
    from uniforce_vtla.arguments import parse

    config = parse(ScoreConfig, ["rollouts=3", "--level=paper", "swap=touch0:left"])
    assert (config.rollouts, config.level, config.swap) == (3, "paper", "touch0:left")
