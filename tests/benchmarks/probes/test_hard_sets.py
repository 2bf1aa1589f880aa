"""Sets that are hard on purpose: recipes kept apart from pretraining, drawn the same every time."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from outside_family import outside

from benchmarks.probes.hard_sets import (
    HELDOUT_HIDDEN,
    HELDOUT_VISIBLE,
    HELDOUT_VISIBLE_2,
    HETERO_HARD,
    HETERO_HARD_TRAINING,
    draw_hard,
    draw_hard_pairs,
    hetero_sensors,
    pairs_digest,
    visible_sensors,
    visible_sensors_2,
)
from benchmarks.probes.labelled_cache import cached
from benchmarks.probes.report_sets import REPORT_SETS, get_report_set
from uniforce_vtla.contact.family import BOUNDS
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.contact.virtual import as_virtual, hidden_sensors
from uniforce_vtla.errors import ContractError

SHORT = replace(HETERO_HARD, sequences=2, length=4)


def test_seeds_and_indenters_of_training_and_frozen_sets_differ() -> None:
    frozen = (HETERO_HARD, HELDOUT_VISIBLE, HELDOUT_VISIBLE_2, HELDOUT_HIDDEN)
    assert len({s.seed for s in (*frozen, HETERO_HARD_TRAINING)}) == 5
    assert all(set(s.indenters) == set(UNSEEN) for s in frozen)
    assert set(HETERO_HARD_TRAINING.indenters) == set(SEEN)


def test_no_held_out_sensor_is_in_the_pretraining_family() -> None:
    assert any(line.startswith("visible: marker_shape") for line in outside(hetero_sensors()["gelsight_d"]))
    visible = (*visible_sensors().values(), *visible_sensors_2().values())
    for sensor, family in product(visible, BOUNDS.values()):
        found = outside(sensor, family)
        assert found and all(line.startswith("visible") for line in found), (sensor.name, found)
    for sensor in hidden_sensors().values():
        if sensor.spec.signal == "camera":
            found = outside(sensor)
            assert found and all(line.startswith("hidden") for line in found), (sensor.name, found)
    keen, usual = hidden_sensors()["uskin_keen"].material, as_virtual("uskin").material
    assert keen.normal_counts_per_N > 1.25 * usual.normal_counts_per_N  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["gelsight_d", "tactip", "uskin"])
def test_a_set_draws_the_same_every_time(name: str) -> None:
    sensor = hetero_sensors()[name]
    one, two = draw_hard(SHORT, sensor, 32), draw_hard(SHORT, sensor, 32)
    assert one.digest == two.digest and np.array_equal(one.frames, two.frames)
    assert one.frames.shape == (2, 4, 32, 32) and one.force_N.shape == (2, 4, 3)


def test_every_sensor_of_a_recipe_feels_the_same_forces() -> None:
    forces = [draw_hard(SHORT, s, 16).force_N for s in hetero_sensors().values()]
    assert all(np.array_equal(forces[0], f) for f in forces)


def test_the_canonicalizer_is_in_the_way() -> None:
    sensor = hetero_sensors()["gelsight_d"]
    direct = draw_hard(replace(SHORT, canonicalize=False), sensor, 32)
    assert not np.array_equal(direct.frames, draw_hard(SHORT, sensor, 32).frames)


def test_hard_pairs_repeat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.probes.hard_sets.HARD_PAIRS_COUNT", 3)
    sensors = hetero_sensors()
    digests = {pairs_digest(draw_hard_pairs(sensors["uskin"], sensors["tactip"])) for _ in range(2)}
    assert len(digests) == 1


def test_a_cached_set_is_drawn_once(tmp_path: Path) -> None:
    calls = []

    def draw():
        calls.append(1)
        return draw_hard(SHORT, hetero_sensors()["uskin"], 16)

    first, second = (cached(tmp_path, SHORT, "uskin", 16, draw) for _ in range(2))
    assert len(calls) == 1 and first.digest == second.digest and np.array_equal(first.frames, second.frames)
    cached(tmp_path, replace(SHORT, seed=9), "uskin", 16, draw)
    assert len(calls) == 2


def test_report_sets_have_names_and_files_of_their_own() -> None:
    assert all(get_report_set(name).name == name for name in REPORT_SETS)
    files = {file for s in REPORT_SETS.values() for file in (s.facts_file, s.table)}
    assert len(files) == 2 * len(REPORT_SETS)
    with pytest.raises(ContractError, match="hetero_hard_v1"):
        get_report_set("easy")
