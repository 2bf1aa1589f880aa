"""Every verb and benchmark: a few bad inputs made from its options, and its help."""

import contextlib
import importlib.util
import resource
import subprocess
import sys
import tomllib

import pytest
from bad_words import CONTENTS
from command_trials import MODULES, PUBLISHED, ROOT, entry, exit_code, hashes, prepare, trials

from uniforce_cli import main as command
from uniforce_cli.boundary import REFUSED
from uniforce_vtla.arguments import options_of
from uniforce_vtla.options import Existing, Names, Pattern, Plain, Range, Writable

NAMES = sorted(MODULES)
SHARE = 3  # of each command


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return prepare(tmp_path_factory.mktemp("bad"))


@pytest.mark.parametrize("name", NAMES)
def test_bad_inputs_end_in_one_line(name, room, monkeypatch, capfd):
    monkeypatch.chdir(room.folder.parent / "work")
    published, every = hashes(ROOT / PUBLISHED), trials(name, room)
    if name not in command.VERBS:  # a benchmark looks at a file when it comes to it
        every = [trial for trial in every if trial.bad.kind not in FILES]
    for trial in every[:: len(every) // SHARE]:
        code = exit_code(entry(name), trial.words)
        said = "".join(capfd.readouterr())
        is_named = said.count("\n") == 1 and trial.bad.is_named_in(said)
        assert code == REFUSED and is_named, f"{trial.words}: {code}: {said}"
    assert hashes(ROOT / PUBLISHED) == published


FILES = ("damaged", "another kind", "nothing in it", "file for folder", "folder for file")


@pytest.mark.parametrize("name", sorted({*command.VERBS} - {"train"}))
def test_every_file_or_folder_of_a_wrong_kind_is_a_users_error(name, room, monkeypatch, capfd):
    """Whatever a verb is pointed at: one line at the end, after any progress bar, and never a fault of the program."""
    monkeypatch.chdir(room.folder.parent / "work")
    for trial in trials(name, room):
        if trial.bad.kind in FILES:
            code, said = exit_code(entry(name), trial.words), capfd.readouterr().err.splitlines()
            assert code == REFUSED and said[-1].startswith(f"uniforce {name}: "), (
                f"{trial.words}: {code} {said[-1:]}"
            )


@pytest.fixture
def last_words(capfd):
    """Return a function: a command is refused over some words → the last line it says."""

    def run(name, words):
        assert exit_code(entry(name), words) == REFUSED, words
        return capfd.readouterr().err.splitlines()[-1]

    return run


ADDRESSES = "http://[::1 http:// http://127.0.0.1:99999/s ftp://x/y /nowhere /etc/passwd /tmp"


@pytest.mark.parametrize("source", ADDRESSES.split())
def test_a_source_that_is_none_is_a_users_error(source, last_words):
    words = ["sensor=tactip", f"source={source}", "tokenizer=nano"]
    assert last_words("touch", words).startswith("uniforce touch: ")


TRAINED = "policy=pi05_uniforce policy.size=tiny policy.device=cpu dataset.repo_id=local/x steps=1"
EPISODES = ("[99]", "[-1]", "[]", "[0, 0]", "[0.5]", "3", "all", "[a]", "{a: 1}")


@pytest.mark.parametrize("data", ["view", "dataset"])
@pytest.mark.parametrize("episodes", EPISODES)
def test_episodes_that_are_not_there_are_named(data, episodes, room, tmp_path, last_words):
    words = [
        *TRAINED.split(),
        f"dataset.root={room.folder / data}",
        f"output_dir={tmp_path / 'out'}",
    ]
    said = last_words("train", [*words, f"dataset.episodes={episodes}"])
    assert said.startswith("uniforce train: dataset.episodes: expected")


RUN = "config_path={run}"


@pytest.mark.parametrize(
    "given",
    [[], [RUN], [f"{RUN}/checkpoints/last/pretrained_model"], [f"{RUN}/none.json"]],
)
def test_a_run_to_go_on_with_names_its_settings(given, tmp_path, last_words):
    (tmp_path / "checkpoints" / "last" / "pretrained_model").mkdir(parents=True)
    words = ["resume=true", "steps=6", *(word.format(run=tmp_path) for word in given)]
    assert "config_path: expected a checkpoint's train_config.json" in last_words("train", words)


@pytest.mark.parametrize("name", CONTENTS)
def test_settings_of_a_run_that_are_none_are_a_users_error(name, room, last_words):
    for file in (room.folder / name, room.damaged(name, "config.json") / "config.json"):
        said = last_words("train", ["resume=true", f"config_path={file}"])
        assert said.startswith("uniforce train: ")


@pytest.mark.parametrize("name", [name for name in NAMES if name != "train"])
def test_every_option_declares_what_it_may_be(name):
    for option in options_of(entry(name).config_class).values():
        if option.kind in (int, float, str) and not option.name.startswith("run.model."):
            assert option.rule is not None, option.name
        rules = Range, Names, Pattern, Plain, Existing, Writable
        assert option.rule is None or isinstance(option.rule, rules), option.name


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_written_into_published_results_by_default(name):
    config_class = entry(name).config_class
    options = options_of(config_class).values() if config_class else ()
    outputs = [o.default for o in options if isinstance(o.rule, Writable)]
    assert all(not default.startswith(str(PUBLISHED)) for default in outputs)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_help_teaches_with_an_example(name, capsys):
    with contextlib.suppress(SystemExit):
        entry(name)(["--help"])
    said = capsys.readouterr().out
    assert ("uniforce " if name in command.VERBS else "python -m benchmarks.") + name in said


def test_one_command_is_installed_and_names_all_its_verbs(capsys, refuses):
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert list(scripts) == ["uniforce"] and len(command.VERBS) <= 15
    assert command.main([]) == 0
    said = capsys.readouterr().out
    assert all(f"  {verb} " in said for verb in command.VERBS)
    refuses(command.main, ["scoer"], "Did you mean score?")


@pytest.mark.parametrize("verb, most_s", [((), 1.0), *(((verb,), 2.0) for verb in command.VERBS)])
def test_help_is_quick(verb, most_s):
    """Processor time, since the machine may be busy."""
    heavy = "import sys; from uniforce_cli.main import main; from contextlib import suppress\n"
    heavy += f"with suppress(SystemExit): main([*{verb!r}, '--help'])\n"
    heavy += "sys.stderr.write(' '.join({'torch', 'lerobot'} & sys.modules.keys()))"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-c", heavy], check=True, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert not done.stderr
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < most_s


def test_scripts_hold_no_logic_and_shadow_no_library():
    found = sorted((ROOT / "scripts").glob("*.py"))
    assert [script.name for script in found] == ["record.py", "score.py", "train.py"]
    for script in found:
        assert len(script.read_text().splitlines()) <= 12, script.name
        found_at = importlib.util.find_spec(script.stem)
        assert found_at is None or found_at.origin == str(script), (
            f"{script.name} would shadow a library"
        )
