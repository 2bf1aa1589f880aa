"""Only safetensors, JSON, parquet and plain arrays are read: the source says so, and poisoned files
prove it."""

import ast
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from benchmarks.trust.injuries import edit_json
from lerobot_policy_pi05_uniforce.controller import PolicyController
from uniforce_datasets.readers import read_genforce  # noqa: F401  (runs none of them)
from uniforce_vtla.array_file import read_array, read_arrays
from uniforce_vtla.errors import CheckpointError, DatasetError

ROOT = Path(__file__).parents[2]
UNPICKLERS = {"pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
NEVER = {"eval", "exec", "compile", "os.system", "yaml.load", "yaml.unsafe_load", "yaml.full_load"}
NEVER |= {
    "torch.load",
    "pd.read_pickle",
    "pandas.read_pickle",
    "torch.package.PackageImporter",
    "torch.jit.load",
}
PROCESSES = {  # of joblib: its loader is what unpickles files
    "joblib": {"Parallel", "delayed"},
    "joblib.externals.loky": {"process_executor"},
}


def breaches(source):
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = {a.name for a in node.names}
            yield from (name for name in names if name.split(".")[0] in UNPICKLERS)
        elif isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in UNPICKLERS:
            names = {a.name for a in node.names}
            yield from names - PROCESSES.get(node.module, set())
        elif isinstance(node, ast.Call):
            yield from call_breaches(node)


def call_breaches(call):
    called = ast.unparse(call.func)
    given = {word.arg: ast.unparse(word.value) for word in call.keywords if word.arg}
    if called in NEVER:
        yield called
    for trust in ("allow_pickle", "trust_remote_code", "shell"):
        if given.get(trust, "False") != "False":
            yield f"{called} with {trust}"
    if called in ("np.load", "numpy.load") and len(call.args) > 2:
        yield "np.load with unnamed options"


def test_no_module_can_run_what_a_file_brings_along(source_files):
    assert len(source_files) > 200
    found = {file: list(breaches(file.read_text())) for file in source_files}
    assert not {file: what for file, what in found.items() if what}


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
    assert list(breaches(source))


class Bomb:
    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (Path.touch, (self.mark,))


@pytest.fixture
def mark(tmp_path):
    return tmp_path / "went_off"


MKDIR = {"class": "os.mkdir", "config": {"path": "MARK"}}


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


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda steps: steps.insert(0, MKDIR), "registry_name"),
        (lambda steps: steps[0].update(MKDIR), "registry_name"),
        (lambda steps: steps[3].update(state_file="../elsewhere.safetensors"), "a file beside it"),
        (lambda steps: steps[3].update(state_file="/etc/passwd"), "a file beside it"),
        (lambda steps: steps.clear(), "steps"),
        (lambda steps: steps[0].update(registry_name="no_such_step"), "no_such_step"),
    ],
)
def test_a_checkpoint_runs_no_class_of_its_choice(policy_copy, mark, change, says):
    file = policy_copy / "policy_preprocessor.json"
    content = json.loads(file.read_text())
    change(content["steps"])
    file.write_text(json.dumps(content).replace("MARK", str(mark)))
    with pytest.raises(CheckpointError, match=says):
        PolicyController(policy_copy, {})
    assert not mark.exists()


def test_a_checkpoint_follows_no_path_to_another_tokenizer(policy_copy):
    elsewhere = {"tokenizer": None, "tokenizer_path": "../../elsewhere"}
    edit_json(policy_copy / "config.json", lambda config: config["touch"].update(elsewhere))
    with pytest.raises(CheckpointError, match="never followed"):
        PolicyController(policy_copy, {})
