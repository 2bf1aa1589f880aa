"""Every command: a thin script, an installed entry point, and a help text that teaches by example."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ENTRY_POINTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


@pytest.mark.parametrize("name", sorted(ENTRY_POINTS))
def test_help_teaches_with_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module, function = ENTRY_POINTS[name].split(":")
    with contextlib.suppress(SystemExit):  # argparse leaves this way
        getattr(importlib.import_module(module), function)(["--help"])
    assert re.search("xample|python scripts/", capsys.readouterr().out)


@pytest.mark.parametrize("name", sorted(ENTRY_POINTS))
def test_every_entry_point_has_its_script(name: str) -> None:
    module = ENTRY_POINTS[name].split(":")[0]
    script = ROOT / "scripts" / f"{module.rsplit('.', 1)[1]}.py"
    assert f"from {module} import main" in script.read_text()


def test_scripts_hold_no_logic_and_shadow_no_library() -> None:
    for script in (ROOT / "scripts").glob("*.py"):
        assert len(script.read_text().splitlines()) <= 12, script.name
        assert importlib.util.find_spec(script.stem) is None, f"{script.name} would shadow a library"


def test_key_value_reaches_the_config() -> None:
    from uniforce_cli.score_config import ScoreConfig
    from uniforce_vtla.arguments import parse

    config = parse(ScoreConfig, ["rollouts=3", "--level=paper", "swap=touch0:left"])
    assert (config.rollouts, config.level, config.swap) == (3, "paper", "touch0:left")
