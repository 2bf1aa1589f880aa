"""LeRobot's own commands work on our recordings, called by the entry points of their scripts."""

import importlib
import json
import re
import shutil
import sys

import pytest

from benchmarks.trust.injuries import edit_json
from uniforce_cli.verify import main as verify
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.synthetic import record_synthetic
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.file_hashes import HASHES, read_hashes
from uniforce_vtla.keys import STATE


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two episodes of four frames; read only."""
    return record_synthetic(tmp_path_factory.mktemp("tools") / "demos", 2, 4)


@pytest.fixture
def run(monkeypatch):
    def called(name, *words):
        monkeypatch.setattr(sys, "argv", [f"lerobot-{name.replace('_', '-')}", *words])
        importlib.import_module(f"lerobot.scripts.lerobot_{name}").main()

    return called


def edit(root, kind, *words):
    return ["--repo_id=local/demos", f"--root={root}", f"--operation.type={kind}", *words]


def test_what_delete_and_split_leave_is_whole(recording, run, tmp_path):
    to = [f"--new_root={tmp_path / 'fewer'}", "--new_repo_id=local/fewer"]
    run("edit_dataset", *edit(recording, "delete_episodes", "--operation.episode_indices=[0]", *to))
    parts = ['--operation.splits={"a": [0], "b": [1]}', f"--new_root={tmp_path}"]
    run("edit_dataset", *edit(recording, "split", *parts))
    for name in ("fewer", "a", "b"):
        assert verify([f"root={tmp_path / name}", "rehash=true"]) == 0
        (episode,) = check_dataset(tmp_path / name, "full").episodes
        assert episode.length == 4


def test_verify_says_what_it_compared_with(recording, tmp_path, capsys, refuses):
    bare = tmp_path / "bare"
    shutil.copytree(recording, bare)
    refuses(verify, [f"root={bare}", "verify=off"], "expected full or quick")
    assert verify([f"root={bare}"]) == 0 and "as it was saved" in capsys.readouterr().out
    (bare / HASHES).unlink()
    assert verify([f"root={bare}"]) == 0 and "no hashes to compare" in capsys.readouterr().out


def test_rehashing_pools_the_quantiles(recording, tmp_path):
    root = tmp_path / "averaged"
    shutil.copytree(recording, root)
    pooled = json.loads((root / "meta/stats.json").read_text())
    edit_json(root / "meta/stats.json", lambda stats: stats[STATE].update(q99=[0.0] * 5))
    assert verify([f"root={root}", "rehash=true"]) == 0
    assert json.loads((root / "meta/stats.json").read_text())[STATE] == pooled[STATE]
    check_dataset(root, "full")


@pytest.mark.thorough
def test_merge_feature_removal_and_new_tasks_keep_it_whole(recording, run, tmp_path):
    both, fewer = tmp_path / "both", tmp_path / "fewer"
    merge = ["--operation.type=merge", '--operation.repo_ids=["local/a", "local/b"]']
    roots = f'--operation.roots=["{recording}", "{recording}"]'
    run("edit_dataset", "--new_repo_id=local/both", f"--new_root={both}", *merge, roots)
    columns = '--operation.feature_names=["truth.wrench.left", "truth.wrench.right"]'
    to = [f"--new_root={fewer}", "--new_repo_id=local/fewer"]
    run("edit_dataset", *edit(both, "remove_feature", columns, *to))
    run("edit_dataset", *edit(fewer, "modify_tasks", "--operation.new_task=another"))
    assert verify([f"root={fewer}", "rehash=true"]) == 0
    source = check_dataset(fewer, "full")
    assert [episode.task for episode in source.episodes] == ["another"] * 4
    assert set(source.instructions()) == {"another"}
    assert "truth.wrench.left" not in source.features
    assert verify([f"root={both}", "rehash=true"]) == 0
    stored = read_hashes(both, DatasetError)
    assert stored and not any("episode" in entry for entry in stored.values())  # packed files
    episodes = check_dataset(both, "full").episodes
    assert len({e.videos[k].file for e in episodes for k in e.videos}) == 6
    record_synthetic(both, 1, 4)
    assert len(check_dataset(both, "full").episodes) == 5


def test_info_tells_of_dataset_and_machine(recording, run, capsys, caplog):
    run("edit_dataset", *edit(recording, "info", "--operation.show_features=true"))
    run("info")
    said = capsys.readouterr().out + caplog.text
    assert "observation.images.tactile_left" in said and re.search(r"LeRobot version: 0\.6", said)


def test_the_viewer_writes_an_episode(recording, run, tmp_path):
    pytest.importorskip("rerun", reason="the extra rerun isn't installed")
    where = ["--repo-id=local/demos", f"--root={recording}", f"--output-dir={tmp_path}"]
    run("dataset_viz", *where, "--episode-index=1", "--save=1", "--num-workers=0", "--batch-size=4")
    assert (tmp_path / "local_demos_episode_1.rrd").stat().st_size > 10_000
