"""A result file says by which command it was made."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from uniforce_vtla import results_file
from uniforce_vtla.results_file import provenance, write_json

PRINTS = """
import json
import os
from uniforce_vtla.results_file import provenance
print(json.dumps(provenance()))
"""


def test_a_module_is_named_as_it_is_run_and_a_script_by_its_file(tmp_path):
    for name in ("made/__main__.py", "made/by.py", "script.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(PRINTS)

    def command(*words):
        ran = subprocess.run(
            [sys.executable, *words, "seeds=3"], cwd=tmp_path, capture_output=True, check=True
        )
        return json.loads(ran.stdout)["command"]

    assert command("-m", "made") == "python -m made seeds=3"
    assert command("-m", "made.by") == "python -m made.by seeds=3"
    assert command("script.py") == "script.py seeds=3"


def test_what_json_does_not_know_becomes_null(tmp_path):
    content = {
        "alarm_s": float("inf"),
        "rows": [{"recall": float("nan")}, (1.5, np.float64("-inf"))],
        "n": 3,
    }
    text = write_json(tmp_path / "found.json", content).read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {
        "alarm_s": None, "rows": [{"recall": None}, [1.5, None]], "n": 3
    }  # fmt: skip


def test_a_file_can_be_read_by_whom_the_umask_lets(tmp_path):
    umask = os.umask(0o022)
    try:
        path = write_json(tmp_path / "x.json", {"a": 1})
    finally:
        os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o644
    with pytest.raises(TypeError):
        write_json(tmp_path / "y.json", {"a": object()})
    assert [file.name for file in tmp_path.iterdir()] == ["x.json"]


def test_a_result_names_commit_device_and_whether_the_sources_were_changed(monkeypatch):
    answers = {"rev-parse": "a" * 40, "status": " M uniforce_vtla/errors.py"}
    monkeypatch.setattr(results_file, "_git", lambda word, *_: answers[word])
    monkeypatch.setattr(results_file, "SOURCES", Path(__file__).parents[1])
    found = results_file._checkout.__wrapped__()
    assert found == ("a" * 40, True)
    answers["status"] = ""
    assert results_file._checkout.__wrapped__() == ("a" * 40, False)
    # as in an installed package
    monkeypatch.setattr(results_file, "SOURCES", Path(__file__).parent)
    assert results_file._checkout.__wrapped__() == (None, None)
    assert {"commit", "dirty", "device", "version", "machine"} <= provenance().keys()
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda: "a card")
    assert provenance()["device"] == "a card"
