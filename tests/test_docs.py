"""README and docs name commands with options that they have, and files and functions that exist."""

import ast
import importlib
import os
import re
import shlex
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from uniforce_cli.main import VERBS
from uniforce_vtla.arguments import options_of, read
from uniforce_vtla.contact.faults import FAULTS
from uniforce_vtla.options import Existing, Writable

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
MODULES = ("benchmarks", "uniforce_robots", "standins")  # of `python -m` in fenced code
LEROBOT = Path(str(find_spec("lerobot").submodule_search_locations[0]))
POLICY = ROOT / "policies" / "lerobot_policy_pi05_uniforce"
# of train: LeRobot's parser reads them
NO_FIELDS = {"policy", "env", "verify", "config_path", "resume", "policy.path"}


def name_of(page):
    return str(page.relative_to(ROOT))


def fenced(page):
    """Return the fenced code of a page, lines that end in a backslash joined to the next."""
    blocks = re.findall(r"^( *)```\w*\n(.*?)^\1```", page.read_text(), re.MULTILINE | re.DOTALL)
    return "\n".join(dedent(code) for _, code in blocks).replace("\\\n", " ")


def command_lines(page):
    """Return the words of every `uniforce …` in fenced code and between back ticks, but for those
    with an ellipsis."""
    lines = [line for line in fenced(page).splitlines() if line.startswith("uniforce ")]
    lines += [f"{code} " for code in re.findall(r"(?<!`)`(uniforce [^`]+)`(?!`)", page.read_text())]
    split = [shlex.split(line.replace("VERB", "record"), comments=True)[1:] for line in lines]
    return [[word for word in words if "…" not in word] for words in split]


@cache
def fields(*folders):
    """Return the names of all fields of classes in folders; nothing is imported, LeRobot takes
    seconds."""
    found = set()
    for file in chain.from_iterable(folder.rglob("*.py") for folder in folders):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef):
                found |= {
                    field.target.id for field in node.body if isinstance(field, ast.AnnAssign)
                }
    return found


def unknown(name, known):
    """Return whether a part of a dotted name is no field; names of cameras are free."""
    return "cameras" not in name and bool(set(name.split(".")[1:] or [name]) - known)


def check_train(names):
    ours = fields(POLICY, LEROBOT / "policies" / "pi05", LEROBOT / "configs")
    return [name for name in names if name not in NO_FIELDS and unknown(name, ours)]


def check_words(verb, words):
    """Return what is wrong with the words behind a verb."""
    given = [word for word in words if not word.startswith("--help")]
    names = [word.removeprefix("--").partition("=")[0] for word in given]
    if verb == "train":
        return check_train(names)
    command = importlib.import_module(f"uniforce_cli.{verb}").main
    devices = [name for name in names if command.others and name.startswith(command.others)]
    own = [word for word, name in zip(given, names, strict=True) if name not in devices]
    config, texts = read(command.config_class, own)  # raises for an unknown option and a wrong type
    for name in texts:
        rule = options_of(command.config_class)[name].rule
        if rule is not None and not isinstance(rule, Existing | Writable) and "." not in name:
            rule.check(name, getattr(config, name))
    return [name for name in devices if unknown(name, fields(ROOT / "robots" / "uniforce_robots"))]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_line_names_a_verb_and_options_that_it_has(page):
    for words in filter(None, command_lines(page)):
        verbs = words[0].split("|")
        assert not set(verbs) - {*VERBS, "--help"}, words
        if verbs[0] in VERBS:
            given = [word for word in words[1:] if "=" in word or word.startswith("--")]
            assert not check_words(verbs[0], given), words


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_module_and_target_named_exists(page):
    for module in re.findall(r"python -m ([\w.]+)", fenced(page)):
        if module.partition(".")[0] in MODULES:
            assert find_spec(module), module
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"^make (\w+)", fenced(page), re.MULTILINE)) <= targets


def defined(path):
    """Return the names of a module, `Class.method` among them."""
    kinds = ast.FunctionDef | ast.ClassDef
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, kinds):
            inner = [one.name for one in node.body if isinstance(one, kinds)]
            found |= {node.name, *(f"{node.name}.{name}" for name in inner)}
    return found


@pytest.mark.parametrize("page", [DOCS / "method.md", DOCS / "definitions.md"], ids=name_of)
def test_files_and_functions_beside_the_equations_exist(page):
    text = page.read_text()
    paths = set(re.findall(r"`([\w/]+/\w+\.py)`", text))
    assert paths and not [path for path in paths if not (ROOT / path).is_file()]
    for path, names in re.findall(r"`([\w/]+\.py)`[:,] ((?:`[\w.]+`(?:, )?)+)", text):
        missing = set(re.findall(r"`([\w.]+)`", names)) - defined(ROOT / path)
        assert not missing, f"{path}: {missing}"


def test_links_of_the_readme_lead_somewhere():
    """Those of other pages are checked where the site is built."""
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", (ROOT / "README.md").read_text())
    local = [link for link in links if "://" not in link]
    assert local and not [link for link in local if not (ROOT / link).exists()]


def test_the_page_of_faults_names_every_one():
    page = (DOCS / "stress.md").read_text()
    rows = re.findall(r"^\| \w+ \| `(\w+)` \| [^|]* \| [^|]* \| [^|]* \|$", page, re.MULTILINE)
    assert set(FAULTS) == set(rows)


def test_readmes_python_runs_and_reads_the_press():
    code, names = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL), {}
    exec(code[1], names)
    said = re.search(r"about ([-\d., ]+) where 1, 0, 6 press", code[1])[1]
    printed_N = [float(number) for number in said.split(", ")]
    np.testing.assert_allclose(names["reading"].force_N, printed_N, atol=0.06)
    np.testing.assert_allclose(names["reading"].force_N, [1, 0, 6], atol=0.25)


def test_own_datas_python_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in re.findall(
        r"```python\n(.*?)```", (ROOT / "docs/own_data.md").read_text(), re.DOTALL
    ):
        exec(code, names)
    assert names["recording"].frames.shape[0] == 5
    assert (tmp_path / "outputs/mine/meta/info.json").is_file()


def test_the_site_builds_without_a_warning(tmp_path):
    """Every link and anchor is checked, and that the site lists every page; nothing is fetched."""
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        tmp_path,
    ]
    env = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert (tmp_path / "tutorial.html").is_file()


def sentences(text):
    """Return the sentences of a page, without code, tables, headings and link targets."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    kept = [line for line in text.splitlines() if not line.startswith(("|", "#", "!", "`"))]
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(kept))
    plain = re.sub(r"`[^`]*`", "code", plain).replace("*", "")
    parts = re.split(r"(?<=[.!?:])\s+|\n\n|\n- | · ", plain)
    return [part.strip() for part in parts if part.strip()]


def test_the_first_page_is_short_and_plain():
    page = (ROOT / "README.md").read_text()
    lengths = [len(sentence.split()) for sentence in sentences(page)]
    numbers = re.findall(r"(?<![\w.])\d[\d.,]*", " ".join(sentences(page)))
    assert page.count("\n") <= 130
    assert max(lengths) <= 28 and np.median(lengths) <= 15
    assert len(numbers) <= 0.03 * sum(lengths)
