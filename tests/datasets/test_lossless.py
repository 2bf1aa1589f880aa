from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.staging import HASHES
from uniforce_datasets.synthetic import FPS, record_synthetic
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import tactile_key


@pytest.fixture
def copy(demos: Path, tmp_path: Path) -> Path:
    """A dataset to spoil, without hashes: its content is all there is to judge it by."""
    root = Path(shutil.copytree(demos, tmp_path / "copy"))
    (root / HASHES).unlink()
    return root


def a_video(root: Path, key: str = tactile_key("left")) -> Path:
    return sorted((root / "videos" / key).rglob("*.mp4"))[-1]


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [truncate, empty, Path.unlink])
@pytest.mark.parametrize("part", ["videos", "data", "meta/episodes"])
def test_truncated_dataset_is_refused(copy: Path, damage: Callable[[Path], None], part: str) -> None:
    damage(sorted(p for p in (copy / part).rglob("*") if p.is_file())[-1])
    with pytest.raises(DatasetError):
        open_dataset(copy)


def unknown_codec(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzz1").replace(b"mp4v", b"zzzv"))


def test_a_video_of_no_known_codec_is_refused(copy: Path) -> None:
    unknown_codec(a_video(copy))
    with pytest.raises(DatasetError, match="codec"):
        open_dataset(copy)


@pytest.mark.parametrize("damage", [truncate, empty, Path.unlink])
def test_broken_info_is_refused(copy: Path, damage: Callable[[Path], None]) -> None:
    damage(copy / "meta" / "info.json")
    with pytest.raises(DatasetError):
        open_dataset(copy)


def test_dataset_without_reference_is_refused(copy: Path) -> None:
    info = json.loads((copy / "meta" / "info.json").read_text())
    del info["features"][tactile_key("left", reference=True)]
    (copy / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(DatasetError, match=r"tactile_left_ref.*record it again"):
        open_dataset(copy)


def test_lossy_marker_video_is_refused(tmp_path: Path) -> None:
    root = record_synthetic(tmp_path / "data", 1, 4)
    (root / HASHES).unlink()
    rng = np.random.default_rng(0)
    with av.open(str(a_video(root)), "w") as video:
        stream = video.add_stream("h264", FPS, options={"crf": "23", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
        for _ in range(4):
            noise = (rng.random((480, 640, 1)) > 0.9).astype(np.uint8) * np.full(3, 255, np.uint8)
            video.mux(stream.encode(av.VideoFrame.from_ndarray(noise, format="rgb24")))
        video.mux(stream.encode())
    with pytest.raises(DatasetError, match=r"only 0 and 255.*crf 0"):
        open_dataset(root)


def test_folder_without_dataset_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"info\.json"):
        open_dataset(tmp_path)
