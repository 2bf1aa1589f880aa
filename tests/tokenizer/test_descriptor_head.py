"""A descriptor head: what it learnt survives saving, and what doesn't fit is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from uniforce_vtla.errors import CheckpointError, ContractError
from uniforce_vtla.file_hashes import drop_hashes
from uniforce_vtla.sensors import list_sensors
from uniforce_vtla.tokenizer.descriptor import NATURAL_UNITS
from uniforce_vtla.tokenizer.descriptor_head import DescriptorHead


def wipe(seed: int, frames: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Return descriptors that are the force itself, and the force."""
    force = np.random.default_rng(seed).uniform(-4, 4, (frames, 3)).astype(np.float32)
    return (np.concatenate([force, force], axis=1) * NATURAL_UNITS).astype(np.float32), force


def test_a_saved_gauge_reads_the_same(tmp_path) -> None:
    head = DescriptorHead.fit("tactip", [wipe(seed) for seed in range(8)], stretch=20, steps=150)
    felt, force = wipe(100)
    said = head.read(felt)
    assert np.abs(said - force).mean() < 0.5 * np.abs(force).mean()
    head.save(tmp_path)
    np.testing.assert_array_equal(DescriptorHead.from_pretrained("tactip", tmp_path).read(felt), said)
    with pytest.raises(CheckpointError):
        DescriptorHead.from_pretrained("uskin", tmp_path)


def test_a_gauge_of_another_descriptor_is_refused(tmp_path) -> None:
    folder = DescriptorHead.fit("tactip", [wipe(0)], stretch=20, steps=1).save(tmp_path)
    drop_hashes(folder)
    facts = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(facts | {"descriptor": ["dx"]}))
    with pytest.raises(CheckpointError, match="Make it again"):
        DescriptorHead.from_pretrained("tactip", tmp_path)


@pytest.mark.parametrize("sensor", list_sensors())
def test_every_sensor_has_a_shipped_gauge_that_refuses_nonsense(sensor: str) -> None:
    head = DescriptorHead.from_pretrained(sensor)
    assert head.read(np.zeros((5, 6))).shape == (5, 3)
    with pytest.raises(ContractError, match="plain_touch"):
        head.read(np.zeros((5, 4)))
    with pytest.raises(ContractError, match="finite"):
        head.read(np.full((5, 6), np.nan))
