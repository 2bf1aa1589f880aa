"""An error of a command becomes one line and an exit code; options are checked before the work
begins."""

import os
import signal
import warnings
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stderr
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, get_args
from unittest.mock import Mock

import httpx
import pytest
import torch
from huggingface_hub.errors import (
    HfHubHTTPError,
    HFValidationError,
    LocalTokenNotFoundError,
    OfflineModeIsEnabled,
)

from lerobot_env_uniforce_wiping import LEVELS
from lerobot_env_uniforce_wiping.gripper import GRIPPERS
from uniforce_cli.boundary import Gripper, Level, command, guarded
from uniforce_vtla.arguments import help_text, options_of, parse
from uniforce_vtla.errors import FULL, ContractError, DiskFullError
from uniforce_vtla.options import (
    LONGEST,
    Count,
    Dataset,
    Names,
    OutFile,
    OutFolder,
    Positive,
    Seeds,
    Share,
    Sizes,
    Text,
    Texts,
    try_to_write,
)
from uniforce_vtla.terminal import STOPS


@dataclass
class Inner:
    """A part."""

    share: Share = 0.5  # of them


@dataclass
class Config:
    """Do something.

    Example: uniforce-something count=3
    """

    count: Count = 3  # how many
    width: Positive = 1.0
    # which of both
    kind: Literal["one", "other"] = "one"
    names: Annotated[str, Names(("a", "b"), many=True)] = ""
    seeds: Seeds = field(default_factory=list)  # of scenes
    sides: Sizes = (1.0, 2.0)
    words: Texts = field(default_factory=list)
    note: Text = ""
    data: Dataset = ""
    inner: Inner = field(default_factory=Inner)
    flag: bool = False
    out: OutFolder = "outputs/x"
    file: OutFile = "outputs/x.json"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_given_reaches_the_config(here):
    words = ["count=7", "--inner.share=0.25", "names=b,a"]
    config = parse(Config, [*words, "seeds=[1, 2]", "note=on: [3]", "flag=true"])
    assert (config.count, config.inner.share, config.names) == (7, 0.25, "b,a")
    assert (config.seeds, config.note, config.flag) == ([1, 2], "on: [3]", True)
    assert not list(here.iterdir())  # what tried the outputs is gone


def test_a_tilde_that_the_shell_left_leads_home(here, monkeypatch):
    home = here / "home"
    (home / "demos" / "meta").mkdir(parents=True)
    (home / "demos" / "meta" / "info.json").touch()
    monkeypatch.setenv("HOME", str(home))
    words = ["data=~/demos", "out=~/new/folder", "file=~/x.json", "note=~/not a path"]
    config = parse(Config, words)
    assert config.data == f"{home}/demos" and config.note == "~/not a path"
    assert (config.out, config.file) == (f"{home}/new/folder", f"{home}/x.json")
    assert [path.name for path in here.iterdir()] == ["home"]
    with pytest.raises(ContractError, match=r"~no_such_user/x.*leads somewhere"):
        parse(Config, ["out=~no_such_user/x"])


@pytest.mark.parametrize(
    "word, reason",
    [
        ("count=0", "count: expected 1 … 10,000,000, got 0"),
        ("count=1.5", "a whole number"),
        ("count=true", "a whole number"),
        ("count=null", "a whole number"),
        ("count=", "got nothing"),
        ("width=0", "above 0"),
        ("width=nan", "a number"),
        ("width=inf", "a number"),
        ("width=1e999", "a number"),
        ("kind=third", "one | other"),
        ("names=a,c", "got c"),
        ("seeds=[1, -1]", "got -1"),
        ("seeds=3", "a list"),
        ("seeds=[x]", "seeds: expected a list"),
        ("sides=[1]", "sides: expected a list"),
        ("sides=[1, a: 2]", "sides: expected a list"),
        ("words=[a: 1]", "words: expected a list"),
        ("flag=yes", "true | false"),
        ("note=a\x07", "printable"),
        ("note=" + "x" * (LONGEST + 1), "at most 4,000 characters"),
        ("inner.share=2", "inner.share"),
        ("inner.shar=2", "Did you mean inner.share"),
        ("data=nowhere", "recorded dataset"),
        ("data=" + "n" * 300, "data"),
        ("out=", "got nothing"),
        ("out=/proc/nothing/x", "out"),
        ("out=" + "n" * 300, "out"),
        ("file=.", "a folder"),
        ("conut=3", "Did you mean count"),
        ("count", "key=value"),
        ("=3", "key=value"),
    ],
)
def test_what_is_wrong_is_named(word, reason):
    with pytest.raises(ContractError) as error:
        parse(Config, [word])
    assert reason in str(error.value) and "\n" not in str(error.value)


def test_an_option_is_given_once():
    with pytest.raises(ContractError, match="once"):
        parse(Config, ["count=1", "--count=2"])


def test_a_file_is_no_parent(here):
    (here / "file").touch()
    with pytest.raises(ContractError, match=r"out: .*file"):
        parse(Config, ["out=file/below"])


def test_folders_that_were_there_stay(here):
    (here / "a").mkdir()
    try_to_write(here / "a" / "b" / "c")
    assert list(here.rglob("*")) == [here / "a"]


def test_help_shows_comment_default_and_range():
    text = help_text(Config)
    assert "Example: uniforce-something" in text
    assert "count=3  [a whole number, 1 … 10,000,000]\n      how many" in text
    assert "kind=one  [one | other]\n      which of both" in text
    assert options_of(Config)["inner.share"].comment == "of them"


def answer(code):
    request = httpx.Request("POST", "https://huggingface.co/api/repos/create")
    return HfHubHTTPError(f"answered {code}", response=httpx.Response(code, request=request))


@pytest.mark.parametrize(
    "error, code, line",
    [
        (ContractError("a: expected b,\ngot c."), 2, "uniforce-x: a: expected b, got c."),
        (FileNotFoundError(2, "No such file", "here.txt"), 2, "uniforce-x: here.txt: No such file"),
        (KeyboardInterrupt(), 130, "uniforce-x: stopped"),
        (
            PermissionError(13, "Permission denied", Path("here.txt")),
            2,
            "uniforce-x: here.txt: Permission denied",
        ),
        (
            UnicodeDecodeError("utf-8", b"\xf6", 0, 1, "invalid start byte"),
            2,
            "uniforce-x: text files: expected UTF-8",
        ),
        (
            ModuleNotFoundError("No module named 'franky'", name="franky"),
            2,
            "uniforce-x: No module named 'franky'",
        ),
        (ImportError("'x' is required but not installed"), 2, "uniforce-x: 'x' is required"),
        (
            ModuleNotFoundError("No module named 'uniforce_cli.x'", name="uniforce_cli.x"),
            70,
            "uniforce-x: a fault",
        ),
        (
            OfflineModeIsEnabled("no"),
            2,
            "uniforce-x: hub: expected a connection, got HF_HUB_OFFLINE",
        ),
        (httpx.ConnectError("refused"), 2, "uniforce-x: hub: expected a connection, got refused"),
        (answer(401), 2, "uniforce-x: hub: expected a login, got answer 401"),
        (answer(403), 2, "uniforce-x: hub: expected a login, got answer 403"),
        (answer(404), 2, "uniforce-x: hub: expected what was asked for, got answered 404"),
        (LocalTokenNotFoundError("Token is required"), 2, "uniforce-x: Token is required"),
        (
            HFValidationError("Repo id must"),
            2,
            "uniforce-x: hub: expected what was asked for, got Repo id must",
        ),
        (
            ZeroDivisionError("by zero"),
            70,
            "uniforce-x: a fault of this program, ZeroDivisionError: by zero",
        ),
        (ContractError("http://anna:s3cret@cam"), 2, "uniforce-x: http://***@cam"),
        (MemoryError("no"), 2, "uniforce-x: memory: expected enough of it"),
        (torch.OutOfMemoryError("CUDA"), 2, "uniforce-x: memory: expected enough of it, got CUDA"),
        (BrokenProcessPool("gone"), 2, "uniforce-x: workers: expected a worker process that lives"),
        (DiskFullError("no room"), 4, "uniforce-x: no room"),
        *(
            (OSError(number, os.strerror(number)), 4, f"uniforce-x: disk: {os.strerror(number)}")
            for number in FULL
        ),
    ],
)
def test_an_error_is_one_line(error, code, line, capsys):
    assert guarded("uniforce-x", Mock(side_effect=error)) == code
    out, err = capsys.readouterr()
    assert not out and err.startswith(line) and err.count("\n") == 1


def test_a_warning_is_one_line():
    usual = warnings.formatwarning
    said = []

    def main(words):
        said.append(warnings.formatwarning("dim light", UserWarning, "x.py", 7))

    assert command(None)(main)([]) == 0
    assert said == ["warning: dim light\n"]
    assert warnings.formatwarning is usual


@pytest.mark.parametrize("come", ["INT", "TERM", "HUP", "TERM HUP"])
def test_kill_and_a_closed_terminal_end_a_command_like_ctrl_c(come):
    reader, writer = os.pipe()
    os.close(reader)
    tidied = []

    def main(words):
        try:
            signal.raise_signal(signal.Signals[f"SIG{come.split()[0]}"])
        finally:
            for name in come.split()[1:]:
                signal.raise_signal(signal.Signals[f"SIG{name}"])
            tidied.append("all")
        return 0

    # the tests may have been started with some ignored
    before = [signal.default_int_handler, signal.SIG_DFL, signal.SIG_DFL]
    own = list(map(signal.signal, STOPS, before))
    with open(writer, "w") as gone, redirect_stderr(gone):
        assert command(None)(main)([]) == 130 and tidied == ["all"]
    assert list(map(signal.signal, STOPS, own)) == before


def test_debug_shows_where_it_came_from():
    @command(Config)
    def main(config):
        raise ZeroDivisionError(config.count)

    assert main(["count=4"]) == 70
    with pytest.raises(ZeroDivisionError, match="4"):
        main(["count=4", "--debug"])


def test_others_options_are_passed_on():
    @command(Config, others=("robot.",))
    def main(config, flags, given):
        assert given == ["count"] or not given
        return 0 if flags == ["--robot.ip=1"] else config.count

    assert main(["robot.ip=1", "count=4"]) == 0
    assert main(["count=4"]) == 4
    assert main(["robot.ip=1", "--robot.ip=2"]) == 2


def test_levels_are_the_environments():
    assert get_args(Level) == tuple(LEVELS)
    assert get_args(Gripper) == GRIPPERS
