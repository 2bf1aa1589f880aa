"""A few of the benchmark's bad inputs for every command; all of them: ``python -m benchmarks.trust.command_line``."""

import pytest

from benchmarks.trust.bad_words import Room
from benchmarks.trust.command_line import COMMANDS, PUBLISHED, ROOT, _entry, hashes, judge, prepare, trials
from benchmarks.trust.command_worker import Ended, _code
from uniforce_vtla.arguments import Option, options_of
from uniforce_vtla.options import Existing, Names, Pattern, Plain, Range, Writable

NAMES = sorted(COMMANDS)
SHARE = 3  # of each command


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    return prepare(tmp_path_factory.mktemp("bad"))


@pytest.mark.parametrize("name", NAMES)
def test_bad_inputs_end_in_one_line(
    name: str, room: Room, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(room.folder.parent / "work")
    published, every = hashes(ROOT / PUBLISHED), trials(name, room)
    for trial in every[:: len(every) // SHARE]:
        code = _code(_entry(name), trial.words)
        ended = Ended(code, "".join(capfd.readouterr()))
        assert judge(trial, ended) == "one_line", f"{trial.words}: {ended}"
    assert hashes(ROOT / PUBLISHED) == published


def undeclared(option: Option) -> bool:
    """Return whether an option says nothing of what it may be."""
    return option.kind in (int, float, str) and option.rule is None


@pytest.mark.parametrize("name", [name for name in NAMES if name != "train"])
def test_every_option_declares_what_it_may_be(name: str) -> None:
    options = options_of(_entry(name).config_class)
    assert not [o.name for o in options.values() if undeclared(o) and not o.name.startswith("run.model.")]
    rules = {type(option.rule) for option in options.values()} - {type(None)}
    assert rules <= {Range, Names, Pattern, Plain, Existing, Writable}


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_written_into_published_results_by_default(name: str) -> None:
    config_class = _entry(name).config_class
    options = options_of(config_class).values() if config_class else ()
    outputs = [o.default for o in options if isinstance(o.rule, Writable)]
    assert all(not default.startswith(str(PUBLISHED)) for default in outputs)
