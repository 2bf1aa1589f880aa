"""Paths that a file names never lead out of its folder, and are refused before anything else is
opened."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks.trust.injuries import edit_json
from uniforce_cli.pretrain import PRESETS, PretrainCommand
from uniforce_cli.show import ShowDatasetConfig, show_dataset
from uniforce_datasets import dataset_info
from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.source import read_source
from uniforce_datasets.synthetic import BlockMeans, record_synthetic
from uniforce_datasets.training_view import TrainingView, build_view, make_training_dataset
from uniforce_vtla.arguments import parse
from uniforce_vtla.errors import ContractError, DatasetError

INFO = Path("meta") / "info.json"
OPENERS = {
    "read_source": read_source,
    "open_dataset": open_dataset,
    "build_view": lambda root: build_view(root, root.parent / "view", encoder=BlockMeans()),
    "show_dataset": lambda root: show_dataset(
        ShowDatasetConfig(root=str(root), out=str(root.parent / "out"))
    ),
    "make_training_dataset": lambda root: make_training_dataset(
        SimpleNamespace(dataset=SimpleNamespace(root=str(root), repo_id="local/x")), pytest.fail
    ),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record_synthetic(tmp_path_factory.mktemp("paths") / "data", 1, 3)


@pytest.fixture
def dataset(recorded, tmp_path, monkeypatch):
    """A copy to spoil; no parquet and no video of it may be opened."""
    root = Path(shutil.copytree(recorded, tmp_path / "data"))
    monkeypatch.setattr(pq, "ParquetFile", lambda *_: pytest.fail("a parquet file was opened"))
    monkeypatch.setattr(av, "open", lambda *_: pytest.fail("a video was opened"))
    return root


def rename_video(info, name):
    info["features"][name] = info["features"].pop("observation.images.front")


TEMPLATES = [
    "../{video_key}/file-{file_index:03d}.mp4",
    "videos/../../{video_key}.mp4",
    "/etc/{video_key}.mp4",
    "~/{video_key}.mp4",
    "videos\\..\\..\\{video_key}.mp4",
    "videos/{video_key.__class__}.mp4",
    "videos/{video_key!r}.mp4",
    "videos/{file_index:0999999999d}.mp4",
    "videos/{0}.mp4",
    "videos/{video_key",
    "videos/\0{video_key}.mp4",
    7,
]
SPOILT = [
    *(lambda info, t=template: info.update(video_path=t) for template in TEMPLATES),
    *(lambda info, t=template: info.update(data_path=t) for template in TEMPLATES[:3]),
    *(
        lambda info, n=name: rename_video(info, n)
        for name in ("../front", "/etc", "..", "a/b", "a\\b", ".", "")
    ),
]


@pytest.mark.parametrize("opener", OPENERS)
@pytest.mark.parametrize("spoil", SPOILT[:3])
def test_every_opener_refuses_paths_that_lead_outside(dataset, opener, spoil):
    edit_json(dataset / INFO, spoil)
    with pytest.raises(DatasetError, match="a path inside"):
        OPENERS[opener](dataset)


@pytest.mark.parametrize("spoil", SPOILT)
def test_all_kinds_of_paths_are_judged(dataset, spoil):
    edit_json(dataset / INFO, spoil)
    with pytest.raises(DatasetError, match=r"a path inside|names of features"):
        read_source(dataset)


@pytest.mark.parametrize("opener", OPENERS)
@pytest.mark.parametrize("part", ["meta/info.json", "videos", "data/chunk-000/file-000.parquet"])
def test_links_out_of_a_dataset_are_refused(dataset, tmp_path, opener, part):
    outside = (dataset / part).rename(tmp_path / "outside")
    (dataset / part).symlink_to(outside)
    with pytest.raises(DatasetError, match="a path inside"):
        OPENERS[opener](dataset)


def test_links_within_a_dataset_are_followed(recorded, tmp_path):
    root = Path(shutil.copytree(recorded, tmp_path / "data"))
    (root / "videos").rename(root / "pictures")
    (root / "videos").symlink_to("pictures")
    assert read_source(root).num_frames == 3


@pytest.fixture
def view(recorded, tmp_path):
    return build_view(recorded, tmp_path / "view", encoder=BlockMeans())


@pytest.mark.parametrize("name", ["front.npy", "latent_left.npy", "uniforce_view.json"])
def test_links_out_of_a_view_are_refused(view, tmp_path, name):
    outside = (view / name).rename(tmp_path / "outside")
    (view / name).symlink_to(outside)
    with pytest.raises(DatasetError, match="a path inside"):
        TrainingView(view)


def test_a_views_slots_name_fingers_and_no_files(view, tmp_path):
    slots = {"touch0": "../../etc/passwd"}
    edit_json(view / "uniforce_view.json", lambda marker: marker.update(slots=slots))
    np.save(tmp_path / "passwd.npy", np.zeros(3))
    with pytest.raises(ContractError, match="finger"):
        TrainingView(view, verify="off")


def test_a_preset_is_one_of_the_packages_own(tmp_path):
    (tmp_path / "evil.yaml").write_text("steps: 1\n")
    with pytest.raises(ContractError, match="preset"):
        parse(PretrainCommand, [f"preset={tmp_path / 'evil'}"], PRESETS)


def test_plain_paths_pass():
    template = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    assert dataset_info.check_template("here", template) == template
    assert dataset_info.check_key("here", "observation.images.front") == "observation.images.front"
