"""Every named kind of damage to a dataset or view is refused, and the error says where."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.trust.damaged_datasets import DATASET_DAMAGES, Damage, record_whole
from uniforce_datasets.lossless import check_dataset, open_dataset
from uniforce_datasets.staging import HASHES
from uniforce_datasets.training_view import TrainingView
from uniforce_vtla.errors import DatasetError
from uniforce_vtla.keys import tactile_key

ONLY_FULL_SEES = {"bytes of a tactile video overwritten", "one bit of a camera video flipped"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return record_whole(tmp_path_factory.mktemp("whole"))


def test_whole_ones_are_accepted(whole: dict[str, Path]) -> None:
    assert len(check_dataset(whole["dataset"], "full").episodes) == 3
    TrainingView(whole["view"])


@pytest.mark.parametrize("damage", DATASET_DAMAGES, ids=lambda damage: f"{damage.of} {damage.name}")
def test_damage_is_refused_and_named(damage: Damage, whole: dict[str, Path], tmp_path: Path) -> None:
    line = damage.refused(whole[damage.of], tmp_path / "full", "full")
    assert line is not None and damage.said in line and "\n" not in line
    assert "SHA-256" not in line or "uniforce verify" in line or damage.of == "view"
    quick = damage.refused(whole[damage.of], tmp_path / "quick", "quick")
    assert (quick is None) == (damage.name in ONLY_FULL_SEES)


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
