import json
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from outside_family import outside

from benchmarks.finite_elements.sets import FE_CONTACTS, FE_DEV
from benchmarks.probes.hard_sets import HETERO_HARD, HETERO_HARD_TRAINING, draw_hard, hetero_sensors
from benchmarks.probes.labelled_set import (
    FROZEN,
    HEAD_TRAINING,
    SENSORS,
    cached,
    draw_labelled,
    set_facts,
    within,
)
from benchmarks.probes.report_sets import REPORT_SETS
from benchmarks.probes.zero_shot import check_frozen, score, summary, transfer_name
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.contact.virtual import as_virtual, hidden_sensors
from uniforce_vtla.errors import DatasetError

RESULTS = Path(__file__).parents[3] / "docs" / "results"
SHORT = replace(FROZEN, sequences=2, length=3)


def test_sensors_feel_the_same_contacts_and_draws_repeat():
    sets = {sensor: draw_labelled(SHORT, sensor, 16) for sensor in SENSORS}
    for labelled in sets.values():
        np.testing.assert_array_equal(labelled.force_N, sets["gelsight"].force_N)
        assert labelled.frames.shape == (2, 3, 16, 16) and labelled.descriptor.shape == (2, 3, 6)
    assert len({labelled.digest for labelled in sets.values()}) == 3
    assert draw_labelled(SHORT, "uskin", 16).digest == sets["uskin"].digest
    assert draw_labelled(replace(SHORT, seed=1), "uskin", 16).digest != sets["uskin"].digest


def test_a_set_that_changed_is_refused():
    drawn = {"uskin": draw_labelled(SHORT, "uskin", 16)}
    facts = set_facts(FROZEN, drawn)
    check_frozen(facts, drawn)
    with pytest.raises(DatasetError, match="freeze"):
        check_frozen(facts | {"set_hash": "0"}, drawn)


def test_score_of_truth_mean_and_offset():
    truth = np.random.default_rng(0).uniform(-2, 8, (5, 4, 3))
    assert score(truth, truth)["r2"] == [1, 1, 1]
    mean = np.broadcast_to(truth.reshape(-1, 3).mean(axis=0), truth.shape)
    assert score(truth, mean)["r2"] == pytest.approx([0, 0, 0])
    assert score(truth, truth + 0.5)["mae_N"] == pytest.approx([0.5] * 3)


def test_paper_range():
    force = np.array([[0, 0, 12.0], [3.1, 0, 1], [0, -3, 5], [0, 0, 12.1]])
    assert within(force).tolist() == [True, False, True, False]


@pytest.mark.parametrize("name", ["zero_shot_v2", "hetero_hard_v2"])
def test_committed_table_belongs_to_the_frozen_set_and_meets_its_form(name):
    table = json.loads((RESULTS / REPORT_SETS[name].table).read_text())
    frozen = json.loads((RESULTS / REPORT_SETS[name].facts_file).read_text())
    assert table["set_hash"] == frozen["set_hash"]
    for row in table["rows"].values():
        for source, target in permutations(SENSORS, 2):
            assert len(row[transfer_name(source, target)]["r2"]) == 3
    mean = table["summary"]["UniForce"]["mean"]
    assert summary(table["rows"]["UniForce"])["mean"] == pytest.approx(mean)


BRIEF = replace(HETERO_HARD, sequences=2, length=4)


def test_seeds_and_indenters_of_training_and_frozen_sets_differ():
    sets = (HETERO_HARD, HETERO_HARD_TRAINING, FROZEN, HEAD_TRAINING, FE_DEV, FE_CONTACTS)
    assert len({s.seed for s in sets}) == len(sets)
    for frozen, training in ((FROZEN, HEAD_TRAINING), (HETERO_HARD, HETERO_HARD_TRAINING)):
        assert set(frozen.indenters) == set(UNSEEN) and set(training.indenters) == set(SEEN)
    assert not set(UNSEEN) & set(SEEN)


def test_no_held_out_sensor_is_in_the_pretraining_family():
    """Of the sensors of the harder set, tests/tokenizer/test_family.py asks this."""
    for sensor in hidden_sensors().values():
        if sensor.spec.signal == "camera":
            found = outside(sensor)
            assert found and all(line.startswith("hidden") for line in found), (sensor.name, found)
    keen, usual = hidden_sensors()["uskin_keen"].material, as_virtual("uskin").material
    assert keen.rest_counts > 1.25 * usual.rest_counts


def test_every_sensor_of_a_recipe_feels_the_same_forces():
    forces = [draw_hard(BRIEF, s, 16).force_N for s in hetero_sensors().values()]
    assert all(np.array_equal(forces[0], f) for f in forces)


def test_the_canonicalizer_is_in_the_way():
    sensor = hetero_sensors()["gelsight_d"]
    direct = draw_hard(replace(BRIEF, canonicalize=False), sensor, 32)
    assert not np.array_equal(direct.frames, draw_hard(BRIEF, sensor, 32).frames)


def test_a_cached_set_is_drawn_once(tmp_path):
    draw = Mock(return_value=draw_hard(BRIEF, hetero_sensors()["uskin"], 16))
    first, second = (cached(tmp_path, BRIEF, "uskin", 16, draw) for _ in range(2))
    assert first.digest == second.digest and np.array_equal(first.frames, second.frames)
    assert draw.call_count == 1
    cached(tmp_path, replace(BRIEF, seed=9), "uskin", 16, draw)
    assert draw.call_count == 2


def test_report_sets_have_names_and_files_of_their_own():
    assert all(REPORT_SETS[name].name == name for name in REPORT_SETS)
    files = {file for s in REPORT_SETS.values() for file in (s.facts_file, s.table)}
    assert len(files) == 2 * len(REPORT_SETS)
