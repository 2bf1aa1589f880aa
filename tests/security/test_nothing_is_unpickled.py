"""Only safetensors, JSON, parquet and plain arrays are read: the source says so, and poisoned files prove it."""

import ast
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_datasets.readers import read_genforce  # noqa: F401  (importing the readers runs none of them)
from uniforce_vtla.array_file import read_array, read_arrays
from uniforce_vtla.errors import CheckpointError, DatasetError

ROOT = Path(__file__).parents[2]
UNPICKLERS = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
NEVER = {"eval", "exec", "compile", "os.system", "yaml.load", "yaml.unsafe_load", "yaml.full_load"}
NEVER |= {"pd.read_pickle", "pandas.read_pickle", "torch.package.PackageImporter", "torch.jit.load"}
PROCESSES = {  # of joblib: its loader is what unpickles files
    "joblib": {"Parallel", "delayed"},
    "joblib.externals.loky": {"process_executor"},
}


def breaches(source, name):
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (
                f"import {a.name}" for a in node.names if a.name.split(".")[0] in UNPICKLERS
            )
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in UNPICKLERS:
            names = {a.name for a in node.names}
            if not names <= PROCESSES.get(node.module or "", set()):
                yield f"from {node.module} import"
        elif isinstance(node, ast.Call):
            yield from call_breaches(node, name)


def call_breaches(call, name):
    called = ast.unparse(call.func)
    given = {word.arg: ast.unparse(word.value) for word in call.keywords if word.arg}
    if called in NEVER:
        yield called
    if called == "torch.load":
        yield "torch.load"
    if (
        given.get("allow_pickle", "False") != "False"
        or given.get("trust_remote_code", "False") != "False"
    ):
        yield f"{called} that trusts the file"
    if given.get("shell", "False") != "False":
        yield f"{called} through a shell"
    if called in ("np.load", "numpy.load") and len(call.args) > 2:
        yield "np.load with unnamed options"


def test_no_module_can_run_what_a_file_brings_along(source_files):
    assert len(source_files) > 200
    found = {
        str(file.relative_to(ROOT)): list(breaches(file.read_text(), str(file.relative_to(ROOT))))
        for file in source_files
    }
    assert not {name: what for name, what in found.items() if what}


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "from pickle import UnpicklingError",
        "import joblib.memory",
        "from joblib import Parallel, load",
        "np.load(p, allow_pickle=True)",
        "np.load(p, allow_pickle=yes)",
        "np.load(p, None, True)",
        "torch.load(p)",
        "torch.load(p, weights_only=True)",
        "yaml.load(s, Loader)",
        "eval(text)",
        "subprocess.run(c, shell=True)",
        "AutoModel.from_pretrained(p, trust_remote_code=True)",
    ],
)
def test_each_breach_would_be_seen(source):
    assert list(breaches(source, "uniforce_vtla/somewhere.py"))


class Bomb:
    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (Path.touch, (self.mark,))


@pytest.fixture
def mark(tmp_path):
    return tmp_path / "went_off"


def test_the_bomb_works(mark):
    pickle.loads(pickle.dumps(Bomb(mark)))
    assert mark.exists()


def test_poisoned_arrays_are_refused(tmp_path, mark):
    bomb = np.array([Bomb(mark)], dtype=object)
    np.save(tmp_path / "a.npy", bomb)
    np.savez(tmp_path / "a.npz", a=bomb)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Bomb(mark)))
    for read in (
        lambda: read_array(tmp_path / "a.npy"),
        lambda: read_arrays(tmp_path / "a.npz", ["a"]),
        lambda: read_array(tmp_path / "b.npy"),
    ):
        with pytest.raises(DatasetError):
            read()
    assert not mark.exists()


def replace_steps(folder, change):
    file = folder / "policy_preprocessor.json"
    content = json.loads(file.read_text())
    change(content["steps"])
    file.unlink()
    file.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "change, says",
    [
        (
            lambda steps: steps.insert(0, {"class": "os.mkdir", "config": {"path": "MARK"}}),
            "registry_name",
        ),
        (
            lambda steps: steps[0].update({"class": "os.mkdir", "config": {"path": "MARK"}}),
            "registry_name",
        ),
        (lambda steps: steps[3].update(state_file="../elsewhere.safetensors"), "a file beside it"),
        (lambda steps: steps[3].update(state_file="/etc/passwd"), "a file beside it"),
        (lambda steps: steps.clear(), "steps"),
        (lambda steps: steps[0].update(registry_name="no_such_step"), "no_such_step"),
    ],
)
def test_a_checkpoint_runs_no_class_of_its_choice(policy_copy, mark, change, says):
    replace_steps(policy_copy, change)
    file = policy_copy / "policy_preprocessor.json"
    file.write_text(file.read_text().replace("MARK", str(mark)))
    with pytest.raises(CheckpointError, match=says):
        PolicyController(policy_copy, {})
    assert not mark.exists()


def test_a_checkpoint_follows_no_path_to_another_tokenizer(policy_copy):
    config = json.loads((policy_copy / "config.json").read_text())
    (policy_copy / "config.json").unlink()
    config["touch"] |= {"tokenizer": None, "tokenizer_path": "../../elsewhere"}
    (policy_copy / "config.json").write_text(json.dumps(config))
    with pytest.raises(CheckpointError, match="never followed"):
        PolicyController(policy_copy, {})
