"""Every verb and benchmark: what it refuses, what its options declare, and its help."""

import contextlib
import hashlib
import importlib
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from wrong_files import CONTENTS, Room, wrong_files

from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_cli import main as command
from uniforce_cli.boundary import REFUSED
from uniforce_vtla.arguments import options_of
from uniforce_vtla.options import Existing, Names, Pattern, Plain, Range, Writable

ROOT = Path(__file__).parents[2]
PUBLISHED = Path("docs/results")
BENCHMARKS = sorted(  # whatever declares its options to the boundary
    file.parent.name if file.stem == "__main__" else file.stem
    for pattern in ("*.py", "*/__main__.py")
    for file in (ROOT / "benchmarks").glob(pattern)
    if "@command(" in file.read_text()
)
MODULES = {verb: f"uniforce_cli.{verb}" for verb in command.VERBS} | {
    name: f"benchmarks.{name}{'.__main__' * (ROOT / 'benchmarks' / name).is_dir()}"
    for name in BENCHMARKS
}
NAMES = sorted(MODULES)
SOUND = {  # what a command needs besides sound folders, to begin its work
    "verify": "root={room}/dataset",
    "share": "checkpoint={shipped}",
    "touch": "source=standin",
    "estimate": "pad_friction=0.6,0.7",
    "calibrate": "grasps=60",
    "convert": "view={room}/view",
}


def entry(command):
    """Return the function behind a command."""
    return importlib.import_module(MODULES[command]).main


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return Room(tmp_path_factory.mktemp("room")).build()


@pytest.fixture
def last_words(capfd):
    """Return a function: a command is refused over some words → the last line it says."""

    def run(name, words):
        try:
            code = entry(name)(words)
        except SystemExit as ended:
            code = ended.code
        said = capfd.readouterr().err.splitlines()
        assert code == REFUSED, f"{words}: {code} {said[-1:]}"
        return said[-1]

    return run


@pytest.fixture(scope="module")
def own_results(tmp_path_factory):
    """Return a folder with published files of its own; the project's stay as they are."""

    def hashes():
        return [hashlib.sha256(file.read_bytes()).digest() for file in published]

    published = sorted(path for path in (ROOT / PUBLISHED).rglob("*") if path.is_file())
    before, folder = hashes(), tmp_path_factory.mktemp("work")
    shutil.copytree(ROOT / PUBLISHED, folder / PUBLISHED)
    yield folder
    assert hashes() == before


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_option_is_named_in_one_line(name, capfd):
    """The boundary refuses all else that is wrong, as tests/scripts/test_boundary.py shows."""
    assert entry(name)(["no_such_option=1"]) == REFUSED
    out, err = capfd.readouterr()
    assert not out and err.count("\n") == 1 and "no_such_option" in err


@pytest.mark.parametrize("name", sorted({*command.VERBS} - {"train"}))
def test_every_file_or_folder_of_a_wrong_kind_is_a_users_error(
    name, room, own_results, last_words, monkeypatch
):
    """Whatever a verb is pointed at: one line at the end, after any progress bar, and never a fault
    of the program."""
    monkeypatch.chdir(own_results)
    options = options_of(entry(name).config_class)
    sound = {}
    for option in options.values():
        rule = option.rule
        if isinstance(rule, Existing) and option.default not in ("", *rule.words, str(PUBLISHED)):
            sound[option.name] = room.sound(rule.marker)
    named = SOUND.get(name, "").format(room=room.folder, shipped=shipped_checkpoint())
    sound |= dict(word.split("=") for word in named.split())
    for option, path in wrong_files(options, room):
        words = [f"{key}={value}" for key, value in (sound | {option: path}).items()]
        assert last_words(name, words).startswith(f"uniforce {name}: ")


ROBOT = "robot=franka teleop=keyboard prompts=[wipe]"


@pytest.mark.parametrize(
    "word",
    [
        "robot.fps=",
        "robot.stream.rate_hz=-inf",
        "robot.gains.clip_rad=1e999",
        "robot.guards.low=[1.0, x]",
        "robot.touch_in_state=maybe",
        "robot.backend=nosuch",
        "robot.no_such=1",
        "teleop.limits.leash=7",
        "teleop.limits.no_such=1",
    ],
)
def test_a_setting_of_the_robot_that_will_not_do_is_named(word, last_words):
    option = word.partition("=")[0]
    assert option in last_words("record", [*ROBOT.split(), word])


ADDRESSES = "http://[::1 http:// http://127.0.0.1:99999/s ftp://x/y /nowhere /etc/passwd /tmp"


@pytest.mark.parametrize("source", ADDRESSES.split())
def test_a_source_that_is_none_is_a_users_error(source, last_words):
    words = ["sensor=tactip", f"source={source}", "tokenizer=nano"]
    assert last_words("touch", words).startswith("uniforce touch: ")


@pytest.mark.parametrize(
    "words",
    [
        ["steps="],
        ["steps=many"],
        ["steps=0"],
        ["steps=1.5"],
        ["steps"],
        ["steps=1", "--steps=2"],
        ["stepss=1"],
        ["policy.push_to_hub=maybe"],
        ["policy.rtc_config.max_guidance_weight=[1.0]"],
        ["policy.no_such=1"],
        ["dataset.root=nothing"],
        ["policy.path=nothing"],
        ["config_path=nothing/train_config.json"],
        ["output_dir=/proc/nothing/run"],
    ],
)
def test_a_setting_of_training_that_will_not_do_is_named(words, room, last_words):
    sound = {
        "policy": "pi05_uniforce",
        "policy.size": "tiny",
        "policy.device": "cpu",
        "dataset.repo_id": "local/view",
        "dataset.root": room.folder / "view",
        "num_workers": 0,
        "output_dir": "run",
    }
    option = words[0].partition("=")[0]
    sound.pop(option, None)
    given = [f"{name}={value}" for name, value in sound.items()]
    assert option in last_words("train", [*given, *words])


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


def test_a_run_to_go_on_with_keeps_what_its_policy_feels(tmp_path, last_words):
    (tmp_path / "train_config.json").write_text("{}")
    words = ["resume=true", RUN.format(run=tmp_path), "policy.touch.slots={touch0: right}"]
    assert "with what its policy feels as the checkpoint says" in last_words("train", words)


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


HELP = """
import resource, sys
from contextlib import suppress
from uniforce_cli.main import main
for verb in sys.argv[1:]:
    with suppress(SystemExit):
        main([*verb.split(), "--help"])
assert not {"torch", "lerobot"} & sys.modules.keys()
used = resource.getrusage(resource.RUSAGE_SELF)
sys.stderr.write(f"{used.ru_utime + used.ru_stime}")
"""


@pytest.mark.parametrize("verbs, most_s", [([""], 1.0), (command.VERBS, 2.0)])
def test_help_is_quick(verbs, most_s):
    """Processor time, since the machine may be busy; of all verbs together."""
    call = [sys.executable, "-c", HELP, *verbs]
    done = subprocess.run(call, check=True, capture_output=True, text=True)
    assert float(done.stderr) < most_s


def test_scripts_hold_no_logic_and_shadow_no_library():
    found = sorted((ROOT / "scripts").glob("*.py"))
    assert [script.name for script in found] == ["record.py", "score.py", "train.py"]
    for script in found:
        assert len(script.read_text().splitlines()) <= 12, script.name
        module = importlib.util.find_spec(script.stem)
        assert module is None or module.origin == str(script), f"{script} would shadow a library"
