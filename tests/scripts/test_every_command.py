"""Every verb and benchmark: a help text that teaches by example, quickly; nothing else is installed."""

import contextlib
import importlib
import importlib.util
import resource
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from benchmarks.trust.command_line import MODULES
from uniforce_cli import main as command
from uniforce_cli.calibrate import VIRTUAL
from uniforce_vtla.contact.virtual import GELSIGHT_D, hidden_sensors

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


@pytest.mark.parametrize(("verb", "most_s"), [((), 1.0), *(((verb,), 2.0) for verb in command.VERBS)])
def test_help_is_quick(verb: tuple[str, ...], most_s: float) -> None:
    """Processor time, since the machine may be busy."""
    heavy = "import sys; from uniforce_cli.main import main; from contextlib import suppress\n"
    heavy += f"with suppress(SystemExit): main([*{verb!r}, '--help'])\n"
    heavy += "sys.stderr.write(' '.join({'torch', 'lerobot'} & sys.modules.keys()))"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-c", heavy], check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert not done.stderr
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < most_s


def test_the_virtual_sensors_offered_are_those_there_are() -> None:
    assert {*VIRTUAL} == {*hidden_sensors(), GELSIGHT_D.name}


def test_scripts_hold_no_logic_and_shadow_no_library() -> None:
    found = sorted((ROOT / "scripts").glob("*.py"))
    assert [script.name for script in found] == ["record.py", "score.py", "train.py"]
    for script in found:
        assert len(script.read_text().splitlines()) <= 12, script.name
        found_at = importlib.util.find_spec(script.stem)
        assert found_at is None or found_at.origin == str(script), f"{script.name} would shadow a library"
