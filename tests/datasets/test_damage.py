"""Every named kind of damage to a dataset or view is refused, and the error says where; each file
has its hash."""

import hashlib
import json
import logging
import time
from functools import partial
from pathlib import Path

import pytest
from lerobot.datasets.dataset_tools import modify_tasks

from benchmarks.trust.damaged_datasets import DATASET_DAMAGES, data, record_whole, set_value
from benchmarks.trust.injuries import cut, edit_json, flip_bit
from uniforce_cli import share, verify
from uniforce_datasets import hashes
from uniforce_datasets.hashes import PARTS, files_of, stage_hashes
from uniforce_datasets.lossless import check_dataset, open_dataset
from uniforce_datasets.recorder import EpisodeRecorder
from uniforce_datasets.staging import STAGING, commit
from uniforce_datasets.synthetic import FPS, record_synthetic
from uniforce_datasets.training_view import TrainingView
from uniforce_vtla.errors import ContractError, DatasetError
from uniforce_vtla.file_hashes import HASHES, differences, read_hashes, store_hashes
from uniforce_vtla.keys import ACTION, tactile_key

ONLY_FULL_SEES = {"bytes of a tactile video overwritten", "one bit of a camera video flipped"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return record_whole(tmp_path_factory.mktemp("whole"))


def test_whole_ones_are_accepted(whole):
    assert len(check_dataset(whole["dataset"], "full").episodes) == 3
    TrainingView(whole["view"])


@pytest.mark.parametrize("damage", DATASET_DAMAGES, ids=lambda damage: f"{damage.of} {damage.name}")
def test_damage_is_refused_and_named(damage, whole, tmp_path):
    line = damage.refused(whole[damage.of], tmp_path / "full", "full")
    assert damage.said in line and "\n" not in line
    assert "SHA-256" not in line or "uniforce verify" in line or damage.of == "view"
    quick = damage.refused(whole[damage.of], tmp_path / "quick", "quick")
    assert (quick is None) == (damage.name in ONLY_FULL_SEES)


@pytest.fixture
def unhashed(copy):
    """A dataset to spoil, without hashes: its content is all there is to judge it by."""
    (copy / HASHES).unlink()
    return copy


@pytest.mark.parametrize("damage", [cut, partial(cut, share=0), Path.unlink])
@pytest.mark.parametrize(
    "part", ["videos/**/*.mp4", "data/**/*.parquet", "meta/episodes/**/*", "meta/info.json"]
)
def test_truncated_dataset_is_refused(unhashed, damage, part):
    damage(sorted(path for path in unhashed.glob(part) if path.is_file())[-1])
    with pytest.raises(DatasetError):
        open_dataset(unhashed)


def test_a_video_of_no_known_codec_is_refused(unhashed):
    path = sorted((unhashed / "videos" / tactile_key("left")).rglob("*.mp4"))[-1]
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzz1").replace(b"mp4v", b"zzzv"))
    with pytest.raises(DatasetError, match="codec"):
        open_dataset(unhashed)


def test_dataset_without_reference_is_refused(unhashed):
    key = tactile_key("left", reference=True)
    edit_json(unhashed / "meta" / "info.json", lambda info: info["features"].pop(key))
    with pytest.raises(DatasetError, match=r"tactile_left_ref.*record it again"):
        open_dataset(unhashed)


def ours(root, *more):
    return verify.main([f"root={root}", *more])


def test_every_file_has_its_hash_and_episode(demos):
    stored = json.loads((demos / HASHES).read_text())
    assert stored.keys() == {*files_of(demos)}
    assert {name.split("/")[0] for name in stored} < {*PARTS}
    for name, entry in stored.items():
        content = (demos / name).read_bytes()
        assert entry["sha256"] == hashlib.sha256(content).hexdigest()
        assert entry["bytes"] == len(content)
        shared = name in ("meta/info.json", "meta/stats.json", "meta/tasks.parquet")
        assert entry.get("episode") == (None if shared else int(name.split(".")[-2][-3:]))


@pytest.mark.parametrize("name", ["../outside", "/etc/passwd", "\0", "x" * 5000])
def test_a_hash_opens_no_file_outside(copy, name):
    (copy.parent / "outside").write_text("mine")
    edit_json(copy / HASHES, lambda known: known.update({name: {"bytes": 4, "sha256": "0"}}))
    with pytest.raises(DatasetError, match=r"file names with|got none"):
        check_dataset(copy, "full")


def test_a_commit_made_while_a_reader_looks_is_no_damage(copy, monkeypatch):
    stats = copy / "meta" / "stats.json"
    staged = copy / STAGING / "meta"
    staged.mkdir(parents=True)
    (staged / "stats.json").write_text(stats.read_text() + " ")
    stage_hashes(copy)

    def commit_first(*looked_at):
        if (copy / STAGING).is_dir():
            commit(copy)
        return differences(*looked_at)

    monkeypatch.setattr(hashes, "differences", commit_first)
    check_dataset(copy, "full")
    stats.write_text(stats.read_text() + " ")
    with pytest.raises(DatasetError, match=r"stats\.json"):
        check_dataset(copy, "full")


def test_a_dataset_without_hashes_loads_with_one_line(copy, caplog):
    (copy / HASHES).unlink()
    with caplog.at_level(logging.WARNING, "uniforce_datasets"):
        check_dataset(copy)
    assert [r.message.count("uniforce verify") for r in caplog.records] == [1]
    record_synthetic(copy, 1, 4)  # it goes on without, and says so
    assert not (copy / HASHES).exists()
    assert ours(copy, "rehash=true") == 0 and check_dataset(copy, "full").num_frames == 64
    record_synthetic(copy, 1, 4)
    assert check_dataset(copy, "full").num_frames == 68


def test_only_full_quick_and_off_are_depths(copy):
    with pytest.raises(ContractError, match="verify"):
        check_dataset(copy, "fast")
    (copy / "meta" / "stats.json").write_text("{}")
    check_dataset(copy, "off")


def test_a_changed_dataset_is_not_continued(copy):
    (copy / "meta" / "stats.json").write_text("{}")
    with pytest.raises(DatasetError, match=r"stats\.json.*uniforce verify"):
        EpisodeRecorder(copy, "local/x", "gelsight", "tactip", FPS)


def test_edited_by_lerobot_then_hashed_again(copy, capsys):
    assert ours(copy) == 0 and "as it was saved" in capsys.readouterr().out
    modify_tasks(open_dataset(copy), new_task="another")
    assert ours(copy) == 2 and f"uniforce verify root={copy}" in capsys.readouterr().err
    assert ours(copy, "rehash=true") == 0 and ours(copy) == 0
    assert {episode.task for episode in check_dataset(copy, "full").episodes} == {"another"}


def test_content_that_cannot_be_trusted_gets_no_hashes(copy, capsys):
    before = (copy / HASHES).read_text()
    set_value(data(copy), ACTION, float("nan"))
    assert ours(copy, "rehash=true") == 2 and "episode 1" in capsys.readouterr().err
    assert (copy / HASHES).read_text() == before
    with EpisodeRecorder(copy.parent / "busy", "local/x", "gelsight", "tactip", FPS) as recorder:
        assert ours(recorder.root, "rehash=true") == 2 and "one recorder" in capsys.readouterr().err


def test_a_view_is_checked_and_never_hashed_again(view, capsys):
    assert ours(view) == 0 and "view of 3 episodes" in capsys.readouterr().out
    assert ours(view, "rehash=true") == 2 and "uniforce view" in capsys.readouterr().err


def test_a_shared_dataset_is_checked_in_full_first(copy, monkeypatch, capsys):
    pushed = []
    dataset = "lerobot.datasets.lerobot_dataset.LeRobotDataset.push_to_hub"
    monkeypatch.setattr(dataset, lambda self, **_: pushed.append(self.repo_id))
    monkeypatch.setattr("huggingface_hub.HfApi.create_repo", lambda *_, **__: None)
    given = [f"dataset={copy}", "push=somebody/wipe"]
    assert share.main(given) == 0 and pushed == ["somebody/wipe"]
    camera = next((copy / "videos" / "observation.images.front").rglob("*001.mp4"))
    flip_bit(camera)
    check_dataset(copy, "quick")
    assert share.main(given) == 2 and len(pushed) == 1 and "episode 1" in capsys.readouterr().err


def test_hashes_of_a_thousand_episodes_cost_little(tmp_path):
    names = {f"videos/key_{n % 9}/chunk-000/file-{n}.mp4": n for n in range(9000)}
    many = {name: {"bytes": n, "sha256": "0" * 64, "episode": n} for name, n in names.items()}
    began_s = time.process_time()
    store_hashes(tmp_path, many)
    assert read_hashes(tmp_path, DatasetError) == many
    assert time.process_time() - began_s < 1
