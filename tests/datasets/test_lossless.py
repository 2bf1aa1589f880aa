import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from uniforce_datasets.lossless import open_dataset
from uniforce_datasets.staging import HASHES
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import tactile_key


@pytest.fixture
def copy(demos: Path, tmp_path: Path) -> Path:
    """A dataset to spoil, without hashes: its content is all there is to judge it by."""
    root = Path(shutil.copytree(demos, tmp_path / "copy"))
    (root / HASHES).unlink()
    return root


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [truncate, empty, Path.unlink])
@pytest.mark.parametrize("part", ["videos/**/*.mp4", "data/**/*.parquet", "meta/episodes/**/*", "meta/info.json"])
def test_truncated_dataset_is_refused(copy: Path, damage: Callable[[Path], None], part: str) -> None:
    damage(sorted(path for path in copy.glob(part) if path.is_file())[-1])
    with pytest.raises(DatasetError):
        open_dataset(copy)


def test_a_video_of_no_known_codec_is_refused(copy: Path) -> None:
    path = sorted((copy / "videos" / tactile_key("left")).rglob("*.mp4"))[-1]
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzz1").replace(b"mp4v", b"zzzv"))
    with pytest.raises(DatasetError, match="codec"):
        open_dataset(copy)


def test_dataset_without_reference_is_refused(copy: Path) -> None:
    info = json.loads((copy / "meta" / "info.json").read_text())
    del info["features"][tactile_key("left", reference=True)]
    (copy / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(DatasetError, match=r"tactile_left_ref.*record it again"):
        open_dataset(copy)
