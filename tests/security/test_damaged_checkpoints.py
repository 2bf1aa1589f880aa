from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.trust.damaged_checkpoints import CHECKPOINT_DAMAGES, CheckpointDamage
from uniforce_vtla.errors import CheckpointError
from uniforce_vtla.file_hashes import HASHES, check_hashes

ROOT = Path(__file__).parents[2]
OURS = ("checkpoints", "policies", "robots", "uniforce_vtla")
SHIPPED = sorted(path.parent for folder in OURS for path in (ROOT / folder).rglob("model.safetensors"))
SOUND = {damage.sound: replace(damage, damage=lambda _: None) for damage in CHECKPOINT_DAMAGES}


@pytest.mark.parametrize("damage", CHECKPOINT_DAMAGES, ids=lambda damage: damage.name)
def test_a_damaged_checkpoint_is_refused(damage: CheckpointDamage, tmp_path: Path) -> None:
    said = damage.refused(tmp_path)
    assert said is not None and "expected" in said


@pytest.mark.parametrize("sound", SOUND.values(), ids=lambda damage: damage.sound.name)
def test_what_is_not_damaged_is_accepted(sound: CheckpointDamage, tmp_path: Path) -> None:
    assert sound.refused(tmp_path) is None


def test_every_shipped_checkpoint_is_as_it_was_saved() -> None:
    assert len(SHIPPED) >= 18
    for folder in SHIPPED:
        assert (folder / HASHES).is_file(), folder
        check_hashes(folder, CheckpointError)
