from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.trust.damaged_checkpoints import CHECKPOINT_DAMAGES, CheckpointDamage

SOUND = {damage.sound: replace(damage, damage=lambda _: None) for damage in CHECKPOINT_DAMAGES}


@pytest.mark.parametrize("damage", CHECKPOINT_DAMAGES, ids=lambda damage: damage.name)
def test_a_damaged_checkpoint_is_refused(damage: CheckpointDamage, tmp_path: Path) -> None:
    said = damage.refused(tmp_path)
    assert said is not None and "expected" in said


@pytest.mark.parametrize("sound", SOUND.values(), ids=lambda damage: damage.sound.name)
def test_what_is_not_damaged_is_accepted(sound: CheckpointDamage, tmp_path: Path) -> None:
    assert sound.refused(tmp_path) is None
