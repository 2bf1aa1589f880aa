"""Every named kind of damage to a dataset or view is refused, and the error says where."""

from pathlib import Path

import pytest

from benchmarks.trust.damaged_datasets import DATASET_DAMAGES, Damage, record_whole
from uniforce_datasets.lossless import check_dataset
from uniforce_datasets.training_view import TrainingView

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
