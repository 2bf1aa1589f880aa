"""compat.py names every private part of LeRobot that we use, and this LeRobot has each of them."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
from importlib.util import find_spec
from pathlib import Path

import pytest

from lerobot_policy_pi05_uniforce.action import CHECK_ACTION
from lerobot_policy_pi05_uniforce.checkpoint import PROCESSORS, TYPE
from lerobot_policy_pi05_uniforce.weights import CONFIG
from uniforce_cli.compat import PRIVATE, store_action_range

ROOMS = """
    uniforce_vtla lerobot_env_uniforce_wiping uniforce_datasets lerobot_policy_pi05_uniforce
    uniforce_robots uniforce_cli
"""
# programs of their own, and files of a checkpoint
LEFT_OUT = re.compile(r"__main__|\.children|\.assets|\.hub\b")
KNOWN = {(module, name) for module, names in PRIVATE.items() for name in names}
PYTHONS = ("_abc_impl", "_is_protocol", "_registry_name")


def source(module):
    return Path(find_spec(module).origin).read_text()


@pytest.mark.parametrize("module, name", sorted(KNOWN))
def test_lerobot_has_what_we_rely_on(module, name):
    assert re.search(rf"\b{name}\b", source(module)), f"{module} has no {name} any more"


def is_private(name):
    return name.startswith("_") and not name.startswith("__") and name not in PYTHONS


def modules():
    for room in ROOMS.split():
        package = importlib.import_module(room)
        for found in pkgutil.walk_packages(package.__path__, f"{room}."):
            if not LEFT_OUT.search(found.name):
                yield importlib.import_module(found.name)


def made(tree):
    """Return the names of a tree's functions, classes and fields, and of attributes of ``self``."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            if ast.unparse(node.value) in ("self", "cls"):
                names.add(node.attr)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return names


def read(tree):
    return {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}


def class_tree(kind):
    """Return a class's tree, an empty one of a class that some function made."""
    for node in ast.walk(ast.parse(source(kind.__module__))):
        if isinstance(node, ast.ClassDef) and node.name == kind.__name__:
            return node
    return ast.Module([], [])


def shared_with_lerobot(kind):
    """Return (module, name) of what a class of ours takes from, or gives to, LeRobot's above it."""
    found = set()
    bases = [base for base in kind.__mro__[1:] if base.__module__.startswith("lerobot.")]
    for base in bases:
        own = class_tree(kind)
        common = (made(own) | read(own)) & made(class_tree(base))
        found |= {(base.__module__, name) for name in common if is_private(name)}
    return found


def test_no_private_name_of_lerobot_is_used_unlisted():
    used = set()
    ours = set()
    reached = set()  # by attribute, of any object
    words = set()
    for module in modules():
        tree = ast.parse(inspect.getsource(module))
        if module.__name__ != "uniforce_cli.compat":
            words |= {*re.findall(r"\w+", inspect.getsource(module))}
        ours |= made(tree)
        reached |= read(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("lerobot."):
                used |= {(node.module, one.name) for one in node.names if is_private(one.name)}
        for kind in vars(module).values():
            if inspect.isclass(kind) and kind.__module__ == module.__name__:
                used |= shared_with_lerobot(kind)
    assert not used - KNOWN
    listed = {name for _, name in KNOWN}
    assert not listed - words, "no longer used"
    # nobody here made it, so another library did
    theirs = {name for name in reached - ours if is_private(name)} - listed
    of_lerobot = set()
    for file in Path(find_spec("lerobot").origin).parent.rglob("*.py"):
        of_lerobot |= {*re.findall(r"(?:def |self\.)(\w+)\b", file.read_text())} & theirs
    assert not of_lerobot - {"_version", "_device"}  # torch's, psutil's


def test_a_fine_tuned_policy_may_act_where_its_own_demonstrations_did(tmp_path):
    stored = {"low": [0.0], "high": [1.0], "margin": 0.5}
    steps = [{"registry_name": "device_processor", "config": {}}]
    steps.append({"registry_name": CHECK_ACTION, "config": stored})
    (tmp_path / PROCESSORS[1]).write_text(json.dumps({"steps": steps}))
    settings = {"type": TYPE, "action": {"target_range": [[0.2], [3.0]]}}
    (tmp_path / CONFIG).write_text(json.dumps(settings))
    store_action_range(tmp_path)
    found = json.loads((tmp_path / PROCESSORS[1]).read_text())["steps"]
    assert found[1]["config"] == stored | {"low": [0.2], "high": [3.0]}
    assert found[0] == steps[0]


def test_another_policys_processors_are_left_alone(tmp_path):
    (tmp_path / CONFIG).write_text(json.dumps({"type": "act"}))
    store_action_range(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [CONFIG]
